#!/usr/bin/env python3
"""The studio in a browser: bands taught by clicks and keys, a run looked through, a frame vetoed.

    studio.py BROWSER URL [--boards DIR] [--pictures DIR] [--measure N] [--page DIR]

The studio serves the sample rest.mkv with a rig without colours as bare.toml, and the folder of a run as `run`, and as `plain` its
table alone, without the σ of θ. Prints
the command that the page shows, between `command:` and `end`. With --boards, pictures of a board are dropped in. With
--pictures it also writes the views as pictures, light and dark; with --measure it clicks N times on the bands and prints
how long a mask took; with --page the page's own files are taken from a folder, to try them before they are built in. With --picks
another recording than the sample is taught, or measured with --measure, and no more is tried.
"""

import argparse
import re
import statistics
import sys
import time
from pathlib import Path

from playwright.sync_api import expect, sync_playwright

SIZE = [1280, 1024]
PICKS = {"base": (431, 408), "coil": (431, 565), "tip": (430, 607)}


def screen(page, x, y):
    """Where a pixel of the picture is on the screen: the stage shows it whole."""
    box = page.locator(".stage canvas").bounding_box()
    size = SIZE
    scale = min(box["width"] / size[0], box["height"] / size[1])
    left = box["x"] + (box["width"] - size[0] * scale) / 2
    top = box["y"] + (box["height"] - size[1] * scale) / 2
    return left + (x + 0.5) * scale, top + (y + 0.5) * scale


def watched(page):
    """Nothing may go wrong unseen, and nothing may be asked from elsewhere."""
    problems = []
    page.on("pageerror", lambda error: problems.append(f"error in the page: {error}"))
    page.on("console", lambda message: problems.append(message.text) if message.type in ("error", "warning") else None)
    page.on("request", lambda request: problems.append(f"asks {request.url}") if not request.url.startswith(("http://127.0.0.1:", "blob:", "data:")) else None)
    return problems


def small_text(page):
    """Text below 12 px, and what sticks out to the right."""
    return page.evaluate(
        """() => [...document.querySelectorAll("body *")].filter((e) => e.offsetParent && e.textContent.trim() &&
        parseFloat(getComputedStyle(e).fontSize) < 12).map((e) => e.outerHTML.slice(0, 80)).concat(
        document.documentElement.scrollWidth > innerWidth ? ["the page is wider than the window"] : [])"""
    )


def ready(page, url):
    began = time.monotonic()
    page.goto(url)
    page.wait_for_selector("body[data-ready]")
    page.wait_for_selector(".view[data-frame]")
    print(f"first picture after {(time.monotonic() - began) * 1e3:.0f} ms")
    assert "#" not in page.url, "the key is still in the address"
    # All times are known, and the frame is ready for clicks.
    page.wait_for_function("() => !document.querySelector('#at').textContent.includes('…')")
    page.wait_for_timeout(400)


def teach(page, save):
    first = True
    for name, (x, y) in PICKS.items():
        before = page.locator(".view").get_attribute("data-took")
        if name == "coil":
            # By keyboard alone: choose the band, go there with the cross, pick.
            page.keyboard.press("2")
            page.locator(".stage canvas").focus()
            cross_to(page, x, y)
            page.keyboard.press("Enter")
        else:
            page.mouse.click(*screen(page, x, y))
        page.wait_for_function("(b) => (document.querySelector('.view').dataset.took ?? null) !== b", arg=before)
        if first:
            expect(page.locator("#told")).to_contain_text("Patch of its colour")
            first = False
    page.wait_for_selector(".view[data-preview]")
    expect(page.locator("#said")).to_contain_text("All bands are measured in this frame")
    expect(page.locator("#told")).to_contain_text("good: ")
    # What is as in the rig is not in the command.
    page.fill("#rigid", "15")
    page.fill("#exposure", "2.5")
    expect(page.locator("#command")).to_contain_text("--rigid 15mm")
    expect(page.locator("#command")).to_contain_text("--exposure 2.5ms")
    if not save:
        page.fill("#rigid", "")
        page.fill("#exposure", "")
        expect(page.locator("#command")).not_to_contain_text("--rigid")
        expect(page.locator("#command")).not_to_contain_text("--exposure")
        rename(page)
    page.fill("#out", "clicked.toml")
    expect(page.locator("#command")).to_contain_text("--out clicked.toml")
    if save:
        page.click("#save")
        expect(page.locator("#result")).to_contain_text("Saved: clicked.toml", timeout=120_000)
    return page.locator("#command").text_content()


def rename(page):
    """A band that gets another name stays what it was, and no two have one name."""
    name = page.get_by_label("name of band 2")

    def call(it, is_taken=False):
        before = page.locator(".view").get_attribute("data-preview")
        name.fill(it)
        name.press("Tab")
        if not is_taken:
            page.wait_for_function("(b) => document.querySelector('.view').dataset.preview !== b", arg=before)

    call("spool")
    expect(page.locator("#coil")).to_have_value("spool")
    expect(page.locator("#command")).to_contain_text("--coil spool")
    call("tip", is_taken=True)
    expect(page.locator("#said")).to_contain_text("There is a band tip already")
    expect(name).to_have_value("spool")
    call("coil")
    expect(page.locator("#command")).not_to_contain_text("--coil")


def cross_to(page, x, y):
    """The cross begins in the middle of the picture, and goes by 1 or 20 pixels."""
    at = [640, 512]
    for axis, (less, more) in enumerate((("ArrowLeft", "ArrowRight"), ("ArrowUp", "ArrowDown"))):
        way = (x, y)[axis] - at[axis]
        key = more if way > 0 else less
        for _ in range(abs(way) // 20):
            page.keyboard.press(f"Control+Shift+{key}")
        for _ in range(abs(way) % 20):
            page.keyboard.press(f"Shift+{key}")


def review(page):
    page.get_by_role("tab", name="Review").click()
    # There is nothing to compare with yet.
    page.get_by_role("button", name="Open …").nth(1).click()
    page.get_by_role("button", name="run", exact=True).click()
    expect(page.locator("#said")).to_contain_text("Open the run first")
    page.get_by_role("button", name="Open …").first.click()
    page.get_by_role("button", name="plain", exact=True).click()
    expect(page.locator("#frame")).to_contain_text("° ± –°")
    page.get_by_role("button", name="Open …").first.click()
    page.get_by_role("button", name="run", exact=True).click()
    page.wait_for_selector(".review[data-rows]")
    expect(page.locator("#said")).to_contain_text("run: ")
    expect(page.locator("#frame")).not_to_contain_text("± –°")
    page.get_by_role("button", name="Veto this frame").click()
    expect(page.locator("#said")).to_contain_text("why this frame should not be trusted")
    page.wait_for_selector(".review[data-row='0']")
    page.locator("#said").click()
    for _ in range(7):
        page.keyboard.press("ArrowRight")
    page.wait_for_selector(".review[data-row='7']")
    expect(page.locator("#frame")).to_contain_text("frame 7")
    expect(page.locator("#frame")).not_to_contain_text("is being read")
    page.keyboard.press("v")
    page.keyboard.type("<b>a hand</b>")
    page.keyboard.press("Enter")
    expect(page.locator("#vetoes")).to_contain_text("frame 7: <b>a hand</b>")
    page.keyboard.press("ArrowRight")
    expect(page.locator("#frame")).to_contain_text("frame 8")
    page.keyboard.press("ArrowLeft")
    expect(page.locator("#frame")).to_contain_text("vetoed: <b>a hand</b>")
    assert page.locator("#vetoes b").count() == 0, "a comment became markup"


def calibrate(page, folder, count):
    page.get_by_role("tab", name="Calibrate").click()
    page.fill("#glass", "5")
    page.fill("#tank", "254x254x267mm")
    page.set_input_files("#files", sorted(folder.glob("*.png"))[:count])
    page.wait_for_selector(f".calibrate[data-judged='{count}']", timeout=180_000)
    expect(page.locator("#verdict")).to_contain_text("in the base frame")
    expect(page.locator("#verdict")).to_contain_text("What would help most")
    expect(page.locator("#rigcommand")).to_contain_text("catoptra calibrate rig boards/00.png")
    page.wait_for_selector(f".calibrate[data-shown='{count - 1}']")


def measure(page, count):
    took = []
    for k in range(count):
        x, y = list(PICKS.values())[k % 3]
        page.keyboard.press(str(k % 3 + 1))
        before = page.locator(".view").get_attribute("data-took")
        # Beside the last place: the same answer would be as quick.
        page.mouse.click(*screen(page, x + (k % 5 - 2) * 0.4, y + (k % 7 - 3) * 0.4))
        page.wait_for_function("(b) => (document.querySelector('.view').dataset.took ?? null) !== b", arg=before)
        took.append(float(page.locator(".view").get_attribute("data-took")))
        page.wait_for_timeout(60)
        if k % 3 == 2:
            page.get_by_role("button", name="Clear all picks").click()
    took.sort()
    print(f"click to mask: median {statistics.median(took):.0f} ms, p95 {took[int(len(took) * 0.95) - 1]:.0f} ms, {count} clicks")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("browser")
    parser.add_argument("url")
    parser.add_argument("--pictures", type=Path)
    parser.add_argument("--measure", type=int, default=0)
    parser.add_argument("--boards", type=Path)
    parser.add_argument("--page", type=Path)
    parser.add_argument("--picks", help="clicks of another recording, as base@431,408,coil@431,565,tip@430,607; it is taught or measured, and no more")
    parser.add_argument("--size", help="of its pictures, as 2448x2048")
    args = parser.parse_args()
    if args.picks:
        found = re.findall(r"(\w+)@([\d.]+),([\d.]+)", args.picks)
        SIZE[:] = [int(part) for part in args.size.split("x")] if args.size else SIZE
        PICKS.update((name, (round(float(x)), round(float(y)))) for name, x, y in found)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=args.browser, args=["--no-sandbox", "--disable-gpu"])
        problems = []
        for scheme in ("light", "dark") if args.pictures else ("light",):
            page = browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme=scheme)
            if args.page:
                page.route("**/*.{js,css}", lambda route: route.fulfill(path=args.page / route.request.url.rsplit("/", 1)[1]))
            problems += (own := watched(page))
            ready(page, args.url)
            if args.measure:
                measure(page, args.measure)
                page.get_by_role("button", name="Clear all picks").click()
            if args.measure and args.picks:
                page.close()
                break
            command = teach(page, save=scheme == "light")
            small = small_text(page)
            if args.pictures:
                page.screenshot(path=args.pictures / f"studio-teach-{scheme}.jpg", type="jpeg", quality=72)
            if scheme == "light":
                print(f"command:\n{command}\nend")
            if args.picks:
                page.close()
                break
            if args.boards:
                calibrate(page, args.boards, 8 if args.pictures else 4)
                small += small_text(page)
                if args.pictures:
                    page.wait_for_timeout(300)
                    page.screenshot(path=args.pictures / f"studio-calibrate-{scheme}.jpg", type="jpeg", quality=72)
            review(page)
            small += small_text(page)
            page.wait_for_timeout(300)
            if args.pictures:
                page.screenshot(path=args.pictures / f"studio-review-{scheme}.jpg", type="jpeg", quality=72)
                page.get_by_role("button", name="Take the veto back").wait_for()
                page.fill("#comment", "it was another frame")
                page.get_by_role("button", name="Take the veto back").click()
                expect(page.locator("#vetoes")).to_have_text("")
            # A tablet held upright, and phones.
            for width, height in ((800, 1200), (390, 844), (320, 700)):
                page.set_viewport_size({"width": width, "height": height})
                page.wait_for_timeout(200)
                small += small_text(page)
            assert not small, small
            problems += own
            page.close()
        # Who has no key is told so.
        page = browser.new_context().new_page()
        page.goto(args.url.split("#")[0])
        expect(page.locator("#said")).to_contain_text("key")
        browser.close()
    for problem in problems:
        print(problem, file=sys.stderr)
    sys.exit(1 if problems else 0)


if __name__ == "__main__":
    main()

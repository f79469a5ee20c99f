#!/usr/bin/env python3
"""A live run watched in a browser by several pages at once, one of which begins and ends the recording of pictures.

    studio_watch.py BROWSER URL [--pages N] [--seconds T] [--record] [--pictures DIR]

Fails when a page shows nothing new for ten seconds, asks for anything from elsewhere, or has an error. Prints what each page
was shown. With --pictures it also writes the view as pictures, light and dark. With - as the URL the browser is started first, `ready` is printed,
and the URL is read from standard input: a browser that starts takes the processor from the run.
"""

import argparse
import sys
import time
from pathlib import Path

from playwright.sync_api import expect, sync_playwright
from studio import small_text, watched

STALE_S = 10.0


def recording(page):
    """By the keyboard and by the mouse."""
    page.locator("#said").click()
    page.keyboard.press("r")
    page.wait_for_selector(".watch[data-recording='true']")
    expect(page.locator("#recorded")).to_contain_text("Recording into")
    expect(page.locator("#how")).to_be_disabled()
    page.wait_for_timeout(700)
    page.click("#record")
    page.wait_for_selector(".watch[data-recording='false']")
    expect(page.locator("#recorded")).to_contain_text("Not recording")


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("browser")
    parser.add_argument("url")
    parser.add_argument("--pages", type=int, default=2)
    parser.add_argument("--seconds", type=float, default=4)
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--pictures", type=Path)
    args = parser.parse_args()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=args.browser, args=["--no-sandbox", "--disable-gpu"])
        schemes = ["dark" if k % 2 else "light" for k in range(args.pages)]
        pages = [browser.new_page(viewport={"width": 1280, "height": 800}, color_scheme=scheme) for scheme in schemes]
        problems = [watched(page) for page in pages]
        for page in pages:
            page.set_default_timeout(90_000)
        if args.url == "-":
            print("ready", flush=True)
            args.url = sys.stdin.readline().strip()
        for page in pages:
            page.goto(args.url)
            page.wait_for_selector(".watch[data-seq]")
        read = lambda page: page.evaluate("() => ({ ...document.querySelector('.watch').dataset })")
        seen = [[(time.monotonic(), read(page))] for page in pages]
        began = time.monotonic()
        recorded = not args.record
        while time.monotonic() - began < args.seconds:
            for page, shown in zip(pages, seen):
                now = read(page)
                if now["seq"] != shown[-1][1]["seq"]:
                    shown.append((time.monotonic(), now))
                age = time.monotonic() - shown[-1][0]
                assert age < STALE_S, f"nothing new for {age:.1f} s"
            if not recorded:
                recording(pages[0])
                recorded = True
            time.sleep(0.1)
        small = sum((small_text(page) for page in pages), [])
        if args.pictures:
            for page, scheme in zip(pages, ("light", "dark")):
                page.screenshot(path=args.pictures / f"studio-watch-{scheme}.jpg", type="jpeg", quality=72)
        # A tablet held upright.
        pages[0].set_viewport_size({"width": 800, "height": 1200})
        pages[0].wait_for_timeout(200)
        small += small_text(pages[0])
        for shown in seen:
            rows = int(shown[-1][1]["seq"]) - int(shown[0][1]["seq"])
            pictures = len({state.get("picture") for _, state in shown})
            times = [at for at, _ in shown]
            longest = max((b - a for a, b in zip(times, times[1:])), default=0)
            print(f"a page followed {rows} rows, the longest pause {longest:.1f} s, {len(shown)} times something new, {pictures} pictures or more")
        browser.close()
    for problem in small + sum(problems, []):
        print(problem, file=sys.stderr)
    sys.exit(1 if small or any(problems) else 0)


if __name__ == "__main__":
    main()

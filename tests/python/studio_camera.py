#!/usr/bin/env python3
"""Pictures of a board taken with a camera in a browser: by the button, by the key, and by itself.

    studio_camera.py BROWSER URL [--by-itself N] [--pictures DIR]

The studio serves a camera, and a rig file with that camera. With --by-itself the box is ticked first, and N pictures must come.
"""

import argparse
import sys
from pathlib import Path

from playwright.sync_api import expect, sync_playwright
from studio import small_text, watched


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("browser")
    parser.add_argument("url")
    parser.add_argument("--by-itself", type=int, default=0)
    parser.add_argument("--pictures", type=Path)
    args = parser.parse_args()
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=args.browser, args=["--no-sandbox", "--disable-gpu"])
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        problems = watched(page)
        page.goto(args.url)
        # With a camera the page begins there.
        page.wait_for_selector(".calibrate[data-look]")
        page.fill("#glass", "5")
        page.fill("#tank", "254x254x267mm")
        taken = lambda count: page.wait_for_selector(f".calibrate[data-taken='{count}']", timeout=120_000)
        if args.by_itself:
            page.check("#byitself")
            for count in range(1, args.by_itself + 1):
                taken(count)
                print(f"{count}: {page.locator('#camerasays').text_content()}")
            page.uncheck("#byitself")
        before = int(page.locator(".calibrate").get_attribute("data-taken") or 0)
        page.click("#takepicture")
        taken(before + 1)
        page.locator("#said").click()
        page.keyboard.press("t")
        taken(before + 2)
        expect(page.locator("#boards .row")).to_have_count(before + 2)
        expect(page.locator("#boards")).to_contain_text("2 images")
        page.get_by_role("button", name="Show the camera").click()
        small = small_text(page)
        if args.pictures:
            page.screenshot(path=args.pictures / "studio-camera-light.jpg", type="jpeg", quality=72)
        page.set_viewport_size({"width": 800, "height": 1200})
        page.wait_for_timeout(200)
        small += small_text(page)
        browser.close()
    for problem in small + problems:
        print(problem, file=sys.stderr)
    sys.exit(1 if small or problems else 0)


if __name__ == "__main__":
    main()

"""What scripts/pages.sh does once there is a browser to do it with."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

WIDE, PHONE = {"width": 1200, "height": 900}, {"width": 390, "height": 844}
# Software rendering, so that it is the same on machines without a GPU.
FLAGS = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
SEEN = "c => c.toDataURL()"


def opened(browser, page, faults, name, **options):
    context = browser.new_context(**options)
    tab = context.new_page()
    tab.on("console", lambda m: faults.append(f"{name}: console: {m.text}") if m.type in ("error", "warning") else None)
    tab.on("pageerror", lambda e: faults.append(f"{name}: {e}"))
    url = page.resolve().as_uri()
    # What is in the page itself (data:) asks nobody.
    own = (url, "data:", "blob:")
    tab.on("request", lambda r: None if r.url.startswith(own) else faults.append(f"{name}: asks for {r.url}"))
    tab.goto(url)
    tab.wait_for_timeout(400)
    return tab


def turns(tab, faults, name):
    """Whether every view in space changes when it is dragged, and with the keyboard; how many there are."""
    views = tab.locator(".view3d canvas")
    for at in range(views.count()):
        canvas = views.nth(at)
        canvas.scroll_into_view_if_needed()
        tab.wait_for_timeout(150)
        box, before = canvas.bounding_box(), canvas.evaluate(SEEN)
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        tab.mouse.move(*middle)
        tab.mouse.down()
        tab.mouse.move(middle[0] + 90, middle[1] + 40, steps=5)
        tab.mouse.up()
        tab.wait_for_timeout(150)
        dragged = canvas.evaluate(SEEN)
        canvas.focus()
        tab.keyboard.press("ArrowLeft")
        tab.wait_for_timeout(150)
        typed = canvas.evaluate(SEEN)
        tab.keyboard.press("0")
        tab.wait_for_timeout(150)
        again = canvas.evaluate(SEEN)
        for ok, what in [
            (dragged != before, "does not turn when dragged"),
            (typed != dragged, "does not turn by keyboard"),
            (again == before, "is not as at first after 0"),
        ]:
            if not ok:
                faults.append(f"{name}: view {at} {what}")
    return views.count()


def look_at(browser, page, folder, faults):
    name = page.stem
    for scheme in ("light", "dark"):
        tab = opened(browser, page, faults, f"{name} {scheme}", viewport=WIDE, color_scheme=scheme)
        tab.screenshot(path=folder / f"{name}-{scheme}.png", full_page=True)
        if scheme == "light":
            views = turns(tab, faults, name)
            tab.pdf(path=folder / f"{name}-print.pdf", format="A4", prefer_css_page_size=True)
        tab.context.close()
    options = {"viewport": PHONE, "device_scale_factor": 2, "has_touch": True, "reduced_motion": "reduce"}
    tab = opened(browser, page, faults, f"{name} phone", **options)
    wide = tab.evaluate("document.documentElement.scrollWidth")
    if wide > PHONE["width"]:
        faults.append(f"{name}: {wide} px wide on a phone of {PHONE['width']}")
    tab.screenshot(path=folder / f"{name}-phone.png", full_page=True)
    tab.context.close()
    if shutil.which("pdftoppm"):
        subprocess.run(["pdftoppm", "-r", "60", "-png", folder / f"{name}-print.pdf", folder / f"{name}-print"], check=True)
    return views


def main(folder, *pages):
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    faults = []
    with sync_playwright() as p:
        browser = p.chromium.launch(executable_path=os.environ["CHROMIUM"], args=FLAGS)
        for page in map(Path, pages):
            views = look_at(browser, page, folder, faults)
            print(f"{page}: {page.stat().st_size / 1e6:.2f} MB, {views} views in space")
        browser.close()
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

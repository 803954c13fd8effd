"""Looks at the built site in a real browser: search, every page at the width of a phone, and pictures to look at.

    browser.py SITE PICTURES

Needs playwright of PyPI and a Chromium (CHROMIUM, or Debian's chromium-headless-shell). Pictures of the pages in SEEN, at
the width of a phone and of a desk, light and dark, are put into the folder PICTURES.
"""

import os
import shutil
import sys
import threading
from functools import partial
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

from playwright.sync_api import sync_playwright

# Terms that a reader types, and for each a page that has to be among the first results.
TERMS = {
    "emergency stop": "docs/safety.html",
    "power saving": "docs/wifi.html",
    "turtlebot": "docs/ros2.html",
    "optitrack": "docs/localization.html",
    "makespan": "docs/simulate.html",
    "hidden stations": "docs/radio.html",
    "mcap": "docs/record.html",
    "benchmarl": "docs/vmas-radio.html",
    "prometheus": "docs/watch.html",
    "foxglove": "docs/record.html",
    "crazyflie": "docs/crazyflie.html",
    "onnx": "docs/policy-format-3.html",
    "safety filter": "docs/safety.html",
    "waypoints": "docs/tasks.html",
    "lidar": "docs/senses.html",
    "minstrel": "docs/radio.html",
    "imitation": "docs/training.html",
    "receive_buffer_bytes": "docs/teams.html",
    "ardupilot": "docs/mavlink.html",
    "raspberry pi": "docs/raspberry-pi.html",
    "threats to validity": "docs/evidence/experiments.html",
    "confidential": "docs/run-a-team.html",
}
FIRST = 8
SEEN = [
    "index.html",
    "docs/what-it-is.html",
    "docs/teams.html",
    "docs/watch.html",
    "docs/raspberry-pi.html",
    "docs/evidence/experiments.html",
    "docs/flocking.html",
    "policies/index.html",
    "api.html",
    "teams/offboard.toml.html",
]
SIZES = {"phone": (390, 844), "desk": (1280, 900)}


class Silent(SimpleHTTPRequestHandler):
    """Serves files and logs nothing."""

    def log_message(self, *_):
        pass


def searched(page, base):
    """Types each term and returns which of them do not find their page."""
    missed = []
    for term, wanted in TERMS.items():
        page.goto(f"{base}/index.html")
        page.keyboard.press("s")
        page.wait_for_selector("#mdbook-searchbar:visible, #searchbar:visible")
        page.keyboard.type(term)
        results = page.locator("#mdbook-searchresults a, #searchresults a")
        results.first.wait_for(timeout=15000)
        page.wait_for_timeout(500)
        found = results.evaluate_all("all => all.map(a => new URL(a.href).pathname.slice(1))")
        pages = list(dict.fromkeys(found))
        place = pages.index(wanted) + 1 if wanted in pages else 0
        print(
            f"search: {term!r} finds {wanted} as page {place} of {len(pages)}"
            if place
            else f"search: {term!r} misses {wanted}"
        )
        if not 0 < place <= FIRST:
            missed.append(f"{term!r} does not find {wanted}: {pages[:FIRST]}")
    return missed


def wide(page, base, names):
    """Returns the pages that are wider than a phone, with what sticks out."""
    script = """() => {
        const width = document.documentElement.clientWidth;
        if (document.documentElement.scrollWidth <= width) return null;
        const out = [...document.querySelectorAll('main *')].filter(e => e.getBoundingClientRect().right > width + 1);
        return out.slice(0, 3).map(e => e.tagName + ': ' + e.textContent.slice(0, 60));
    }"""
    found = []
    for name in names:
        page.goto(f"{base}/{name}")
        if (out := page.evaluate(script)) is not None:
            found.append(f"{name} is wider than a phone: {out}")
    return found


def pictures(browser, base, folder):
    """Takes pictures of the pages in SEEN; returns those that are dark where they should be light, or the reverse."""
    wrong = []
    for scheme in ("light", "dark"):
        for size, (width, height) in SIZES.items():
            context = browser.new_context(color_scheme=scheme, viewport={"width": width, "height": height})
            page = context.new_page()
            for name in SEEN:
                page.goto(f"{base}/{name}")
                page.wait_for_load_state("networkidle")
                brightness = page.evaluate(
                    "getComputedStyle(document.documentElement).backgroundColor.match(/\\d+/g).map(Number)[0]"
                )
                if (brightness > 127) != (scheme == "light"):
                    wrong.append(f"{name} has a ground of {brightness} where {scheme} is wanted")
                file = f"{name.removesuffix('.html').replace('/', '-')}-{size}-{scheme}.png"
                page.screenshot(path=folder / file)
            context.close()
    return wrong


def main():
    site, folder = Path(sys.argv[1]).resolve(), Path(sys.argv[2])
    folder.mkdir(parents=True, exist_ok=True)
    program = os.environ.get("CHROMIUM") or shutil.which("chromium-headless-shell") or shutil.which("chromium")
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(Silent, directory=site))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    base = f"http://127.0.0.1:{server.server_port}"
    names = [str(file.relative_to(site)) for file in sorted(site.rglob("*.html"))]
    names = [name for name in names if not name.startswith(("api/", "toc", "404"))]
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=["--no-sandbox"])
        errors = []
        page = browser.new_page()
        page.on("pageerror", lambda error: errors.append(f"script: {error}"))
        wrong = searched(page, base)
        page.close()
        phone = browser.new_page(viewport={"width": 390, "height": 844})
        phone.on("pageerror", lambda error: errors.append(f"script: {error}"))
        wrong += wide(phone, base, names)
        phone.close()
        wrong += pictures(browser, base, folder)
        browser.close()
    server.shutdown()
    if wrong + errors:
        raise SystemExit("\n".join(wrong + errors))
    print(f"{len(TERMS)} terms, {len(names)} pages at the width of a phone, {len(SEEN) * 4} pictures in {folder}")


if __name__ == "__main__":
    main()

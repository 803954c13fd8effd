"""Checks every link of the built site: its file is there, and its anchor is in that file.

    links.py SITE

Pages of interfaces (`api/`) are made by rustdoc and pdoc; links to them are checked, links in them are theirs.
"""

import sys
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlparse


class Page(HTMLParser):
    """The links and anchors of a page."""

    def __init__(self, text):
        super().__init__()
        self.links, self.anchors, self.pictures = [], set(), 0
        self.feed(text)

    def handle_starttag(self, tag, attributes):
        given = dict(attributes)
        self.anchors.update(given[name] for name in ("id", "name") if given.get(name))
        for name in ("href", "src"):
            if given.get(name):
                self.links.append(given[name])
        self.pictures += tag == "img"


def main():
    site = Path(sys.argv[1]).resolve()
    files = sorted(file for file in site.rglob("*.html") if "api" not in file.relative_to(site).parts[:1])
    pages = {file: Page(file.read_text()) for file in files}
    wrong, checked, anchors, others = [], 0, 0, set()
    for file, page in pages.items():
        for link in page.links:
            address = urlparse(link)
            if address.scheme or address.netloc:
                others.add(link)
                continue
            checked += 1
            # mdBook's page for addresses that are not there has links from the root.
            path = unquote(address.path)
            target = file if not path else (site / path[1:] if path.startswith("/") else file.parent / path).resolve()
            if target.is_dir():
                target /= "index.html"
            here = file.relative_to(site)
            if not target.exists():
                wrong.append(f"{here}: {link} leads nowhere")
            elif address.fragment and target in pages:
                anchors += 1
                if unquote(address.fragment) not in pages[target].anchors:
                    wrong.append(f"{here}: {link} has no such anchor")
    pictures = sum(page.pictures for page in pages.values())
    print(f"{len(pages)} pages, {checked} links within the site, {anchors} of them to anchors, {pictures} pictures")
    print(f"{len(others)} addresses elsewhere, not asked")
    if wrong:
        raise SystemExit("\n".join(sorted(set(wrong))))


if __name__ == "__main__":
    main()

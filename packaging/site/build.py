"""Builds the site: all pages in the order of docs/README.md, the files that they show, notebooks, and interfaces.

    build.py OUT [--mdbook PROGRAM] [--rust FOLDER] [--python]

OUT is replaced. `--rust` is what `cargo doc` has made, `--python` makes the pages of the Python package, which has to
be installed beside pdoc, and those of the notebooks, by nbconvert. Without them the site says that they are not in it.
"""

import argparse
import importlib
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
LINK = re.compile(r"\]\(([^)\s]+)\)")
ENTRY = re.compile(r"^- \[(.+)\]\((.+)\)$")
LANGUAGES = {
    ".py": "python",
    ".rs": "rust",
    ".toml": "toml",
    ".json": "json",
    ".yml": "yaml",
    ".service": "ini",
    ".sh": "sh",
}
# A file that is larger is no reading matter [bytes].
LARGEST = 200_000
PYTHON = ["murmurate"] + [
    f"murmurate.{name}"
    for name in ["policy", "actors", "gymnasium", "pettingzoo", "torchrl", "benchmarl", "vmas", "serve"]
]


def entries():
    """Returns the parts of docs/README.md: title, and for each page its title and its path from the root."""
    parts = []
    for line in (ROOT / "docs/README.md").read_text().splitlines():
        if line.startswith("## "):
            parts.append((line[3:], []))
        elif found := ENTRY.match(line):
            path = os.path.normpath(os.path.join("docs", found[2]))
            parts[-1][1].append((found[1], path))
    return parts


def tracked(folder):
    """Returns the files of a folder that are in the repository and can be shown."""
    names = subprocess.run(["git", "ls-files", folder], cwd=ROOT, check=True, capture_output=True, text=True).stdout
    return [name for name in names.splitlines() if shown(name)]


def shown(name):
    """Whether a file is text of a size that a page can show."""
    path = ROOT / name
    if not path.is_file() or path.stat().st_size > LARGEST:
        return False
    return b"\0" not in path.read_bytes()[:4096]


def placed(target):
    """Returns a link to a page as the site has it: mdBook names a README so, and changes links to other pages alone."""
    return re.sub(r"README\.md(?=#|$)", "index.html", target)


class Stage:
    """The folder from which mdBook builds: pages where they are in the repository, and a page for each file they name."""

    def __init__(self, folder, pages):
        self.folder = folder
        self.pages = set(pages)
        # Files and folders of the repository, in the order in which pages name them, and the pages that show them.
        self.files = {}
        # Pages that are not in the list, such as that of an example; others name them.
        self.further = []

    def page(self, name):
        """Copies a page; its links to files of the repository become links to pages that show these files."""
        text = (ROOT / name).read_text()
        self.write(name, LINK.sub(lambda found: f"]({self.target(name, found[1])})", text))

    def target(self, page, target):
        """Returns where a link of a page leads on the site."""
        path, _, anchor = target.partition("#")
        if "://" in target or target.startswith("mailto:") or not path:
            return target
        name = os.path.normpath(os.path.join(os.path.dirname(page), path))
        if name.endswith(".md") and name not in self.pages and name != "docs/README.md" and (ROOT / name).is_file():
            self.pages.add(name)
            self.further.append(name)
            self.page(name)
        if name in self.pages:
            return placed(target)
        if name.endswith((".svg", ".png")):
            self.copy(name)
            return target
        if name == "docs":
            name = "docs/README.md"
        self.files.setdefault(name, f"{name}.md" if not (ROOT / name).is_dir() else f"{name}/files.md")
        shows = os.path.relpath(self.files[name], os.path.dirname(page) or ".")
        return shows + (f"#{anchor}" if anchor else "")

    def copy(self, name):
        to = self.folder / name
        to.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(ROOT / name, to)

    def write(self, name, text):
        to = self.folder / name
        to.parent.mkdir(parents=True, exist_ok=True)
        to.write_text(text)

    def shows(self):
        """Writes the pages of files and folders that others name, and of the files of these folders."""
        for name in sorted(self.files):
            if (ROOT / name).is_dir():
                listed = tracked(name)
                for file in listed:
                    if file not in self.pages:
                        self.files.setdefault(file, f"{file}.md")
                here = self.files[name]
                items = [(file, placed(file) if file in self.pages else self.files[file]) for file in listed]
                lines = [f"- [`{file}`]({os.path.relpath(page, os.path.dirname(here))})" for file, page in items]
                self.write(here, f"# {name}/\n\nFiles of this folder of the repository.\n\n" + "\n".join(lines) + "\n")
        for name, page in self.files.items():
            if not (ROOT / name).is_dir() and not name.endswith(".ipynb"):
                text = (ROOT / name).read_text()
                fence = "`" * max(3, 1 + max((len(run) for run in re.findall("`+", text)), default=0))
                language = LANGUAGES.get(Path(name).suffix, "text")
                title = f"# {name}\n\nA file of the repository.\n\n"
                self.write(page, f"{title}{fence}{language}\n{text.rstrip()}\n{fence}\n")

    def notebooks(self, rendered):
        """Writes a page for each notebook that pages name: by nbconvert, or else its source."""
        for name, page in self.files.items():
            if not name.endswith(".ipynb"):
                continue
            if rendered:
                made = [sys.executable, "-m", "nbconvert", "--to", "markdown", "--stdout", str(ROOT / name)]
                text = subprocess.run(made, check=True, capture_output=True, text=True).stdout
                note = f"\n\nThis page is the notebook `{name}` of the repository, without its results.\n"
                title, _, rest = text.lstrip().partition("\n")
                self.write(page, title + note + rest)
            else:
                cells = json.loads((ROOT / name).read_text())["cells"]
                texts = ["".join(cell["source"]) for cell in cells]
                code = [cell["cell_type"] == "code" for cell in cells]
                self.write(page, "\n\n".join(f"```python\n{t}\n```" if c else t for t, c in zip(texts, code)) + "\n")


def interfaces(rust, python):
    """Returns the page that leads to the pages of the interfaces."""
    lines = ["# Interfaces of Rust and Python", "", "Made from the sources of this version."]
    lines += ["", "## Rust", ""]
    if rust is None:
        lines.append("This build of the site is without them: `cargo doc --no-deps --open`.")
    for manifest in sorted([ROOT / "Cargo.toml", *(ROOT / "crates").glob("*/Cargo.toml")]):
        package = tomllib.loads(manifest.read_text()).get("package", {})
        module = package.get("name", "").replace("-", "_")
        if rust is not None and (rust / module / "index.html").exists():
            lines.append(f"- [`{module}`](api/rust/{module}/index.html): {package.get('description', '')}")
    lines += ["", "## Python", ""]
    if python is None:
        lines.append("This build of the site is without them: `help(murmurate)`.")
    for module in python or []:
        lines.append(f"- [`{module}`](api/python/{module.replace('.', '/')}.html)")
    if python is not None and (absent := [module for module in PYTHON if module not in python]):
        lines += ["", f"Not here, since what they build on was not installed: {', '.join(f'`{m}`' for m in absent)}."]
    return "\n".join(lines) + "\n"


def importable():
    """Returns the modules of the Python package that can be imported here."""
    found = []
    for module in PYTHON:
        try:
            importlib.import_module(module)
        except ImportError as error:
            print(f"no page of {module}: {error}", file=sys.stderr)
        else:
            found.append(module)
    return found


def summary(parts, stage):
    """Returns mdBook's list of pages."""
    lines = ["# Summary", "", "[Murmurate](README.md)", ""]
    for title, pages in parts:
        lines += [f"# {title}", "", *(f"- [{name}]({path})" for name, path in pages), ""]
    lines += [
        "# Interfaces and files",
        "",
        "- [Interfaces of Rust and Python](api.md)",
        "- [Files that pages show](files.md)",
    ]
    shown = [*stage.files.items(), *((name, name) for name in stage.further)]
    lines += [f"    - [{name}]({page})" for name, page in sorted(shown)]
    return "\n".join(lines) + "\n"


def book(stage, work):
    """Returns the settings of mdBook: files are not searched, since pages say more in fewer hits."""
    text = (HERE / "book.toml").read_text()
    for page in sorted(stage.files.values()):
        if not page.endswith(".ipynb.md"):
            text += f'\n[output.html.search.chapter."{page}"]\nenable = false\n'
    (work / "book.toml").write_text(text)
    shutil.copyfile(HERE / "site.css", work / "site.css")


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--mdbook", default="mdbook")
    parser.add_argument("--rust", type=Path)
    parser.add_argument("--python", action="store_true")
    args = parser.parse_args()
    parts = entries()
    pages = ["README.md"] + [path for _, listed in parts for _, path in listed]
    with tempfile.TemporaryDirectory() as temporary:
        work = Path(temporary)
        stage = Stage(work / "pages", pages)
        for name in pages:
            stage.page(name)
        stage.shows()
        stage.notebooks(args.python)
        python = importable() if args.python else None
        stage.write("api.md", interfaces(args.rust, python))
        stage.write("files.md", "# Files that pages show\n\nThey are in the repository at the paths of their titles.\n")
        stage.write("SUMMARY.md", summary(parts, stage))
        book(stage, work)
        subprocess.run([args.mdbook, "build", str(work)], check=True)
        if args.out.exists():
            shutil.rmtree(args.out)
        shutil.copytree(work / "html", args.out)
    if args.rust is not None:
        shutil.copytree(args.rust, args.out / "api/rust")
    if python:
        made = [
            sys.executable,
            "-m",
            "pdoc",
            "--docformat",
            "google",
            "--output-directory",
            str(args.out / "api/python"),
        ]
        subprocess.run([*made, *python], check=True)
    print(f"{args.out}: {len(pages)} pages, {len(stage.files)} files and folders")


if __name__ == "__main__":
    main()

"""The public face of the library, as the documentation shows it, held against docs/public-face.txt.

    cargo doc --release --no-deps --lib && python3 tests/public_face.py [--write]

A change of the face is a change of that file, so that none is made unawares.
"""

import pathlib
import re
import sys

ROOT = pathlib.Path(__file__).parent.parent
FACE = ROOT / "docs/public-face.txt"


def shown(page):
    """Kind and path of every item on rustdoc's page of all items."""
    for href in re.findall(r'<li><a href="([^"]+)\.html">', page):
        *folders, item = href.split("/")
        kind, _, name = item.partition(".")
        yield f"{'::'.join([*folders, name])} ({kind})"


def main():
    page = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 and sys.argv[1] != "--write" else "")
    page = page if page.is_file() else ROOT / "target/doc/whirls/all.html"
    items = sorted(set(shown(page.read_text())))
    if "--write" in sys.argv:
        FACE.write_text("\n".join(items) + "\n")
    said = FACE.read_text().split("\n")[:-1]
    for item in sorted(set(items) - set(said)):
        print(f"new: {item}")
    for item in sorted(set(said) - set(items)):
        print(f"gone: {item}")
    print(f"{len(items)} items")
    if items != said:
        sys.exit("the public face differs from docs/public-face.txt; if that is meant, --write it")


if __name__ == "__main__":
    main()

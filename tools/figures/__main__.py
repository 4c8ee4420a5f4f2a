"""`python -m tools.figures`: draw every figure, then take the pictures of the lab where there is a Chromium."""

from __future__ import annotations

import argparse
import runpy
import shutil
import sys

from tools.figures import DRAWN, IMAGES, ROOT
from tools.figures.same import difference


def main() -> None:
    """Write what is not as the code has it; names on the command line choose."""
    parser = argparse.ArgumentParser(prog="python -m tools.figures", description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"only these: {', '.join(DRAWN)}, lab")
    names = parser.parse_args().names
    for name, draw in DRAWN.items():
        if names and name not in names:
            continue
        path, text = IMAGES / name, draw()
        # what differs by a rounding stays as it is committed
        if not path.exists() or difference(path.read_text(encoding="utf-8"), text, 1e-5):
            path.write_text(text, encoding="utf-8")
            sys.stdout.write(f"{path.relative_to(ROOT)}\n")
    if names and "lab" not in names:
        return
    if shutil.which("chromium"):
        runpy.run_path(str(ROOT / "tools" / "lab_pictures.py"), run_name="__main__")
    else:
        sys.stdout.write("the pictures of the lab stay as they are: there is no chromium\n")


if __name__ == "__main__":
    main()

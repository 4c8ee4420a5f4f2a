# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""`python -m tools.generate`: rewrite what is not as the code has it, and say which files those were."""

from __future__ import annotations

from tools.generate import ROOT, generated


def main() -> None:
    """Rewrite the generated files."""
    for path, text in generated().items():
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
            print(path.relative_to(ROOT))  # noqa: T201  # what has changed is to be read


if __name__ == "__main__":
    main()

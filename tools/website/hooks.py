# Copyright 2026 The impact_rig developers
#
# Licensed under the Apache License, Version 2.0 (the "License");
# you may not use this file except in compliance with the License.
# You may obtain a copy of the License at
#
#     http://www.apache.org/licenses/LICENSE-2.0
#
# Unless required by applicable law or agreed to in writing, software
# distributed under the License is distributed on an "AS IS" BASIS,
# WITHOUT WARRANTIES OR CONDITIONS OF ANY KIND, either express or implied.
# See the License for the specific language governing permissions and
# limitations under the License.
"""Hooks of MkDocs for our pages: the words after a fence, and the icon of the lab."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import griffe
from mkdocs.structure.files import File

import impact_rig

ROOT = Path(__file__).parents[2]
ICON = ROOT / "impact_rig_lab" / "static" / "icon.svg"
RIG = ROOT / "build" / "rig" / "index.html"
"""The rig as one page, if `make site` has built it."""
_RIG_HERE = "<!-- rig in the browser -->"
_SEARCH = 'data-md-component="search" role="dialog"'
_FENCE = re.compile(r"^(?P<ticks>```+)(?P<language>\w+) (?P<info>.+)$", re.MULTILINE)
API = "reference/api.md"
_PUBLIC = re.compile(rf"<code>({'|'.join(impact_rig.__all__)})</code>")
_PAGE = re.compile(r"\bdocs/([\w/-]+\.md)\b")
_COMMENT = re.compile(r"<!-- (?:figures|generated): .*? -->\n?|<!-- end -->\n?", re.DOTALL)


class Defaults(griffe.Extension):
    """Extension of the API's reader that shows the value of a default, not the name of the constant."""

    def on_package(self, *, pkg: griffe.Module, **_: Any) -> None:
        """Replace the names of constants in the defaults of all functions."""
        modules = [pkg]
        while modules:
            module = modules.pop()
            modules += [one for one in module.modules.values() if not one.is_alias]
            owners = (module, *(one for one in module.classes.values() if not one.is_alias))
            for parameter in (
                one
                for owner in owners
                for func in owner.functions.values()
                if not func.is_alias
                for one in func.parameters
            ):
                if isinstance(parameter.default, griffe.ExprName) and parameter.default.name in module.members:
                    constant: Any = module.members[parameter.default.name]
                    constant = constant.final_target if constant.is_alias else constant
                    if isinstance(constant, griffe.Attribute) and isinstance(constant.value, str):
                        parameter.default = constant.value


def on_files(files: Any, config: Any) -> Any:
    """Add the icon of the lab's page, and the rig in the browser."""
    files.append(File.generated(config, "images/icon.svg", abs_src_path=str(ICON)))
    if RIG.exists():
        files.append(File.generated(config, "images/impact_rig.html", abs_src_path=str(RIG)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Show titles of files above their blocks, and remove comments for our checks."""
    markdown = markdown.replace(
        _RIG_HERE, "[Run the rig in this browser](images/impact_rig.html)" if RIG.exists() else ""
    )
    return _FENCE.sub(_fence, _COMMENT.sub("", markdown))


def on_page_content(html: str, page: Any, files: Any, **_: Any) -> str:
    """Link what docstrings name on the page of the API: public names, and pages by their paths."""
    if page.file.src_uri != API:
        return html
    html = _PUBLIC.sub(r'<a href="#impact_rig.\1"><code>\1</code></a>', html)
    return _PAGE.sub(lambda found: _link(found[0], found[1], page.file, files), html)


def _link(text: str, path: str, origin: File, files: Any) -> str:
    target = files.get_file_from_path(path)
    return f'<a href="{target.url_relative_to(origin)}">{text}</a>' if target else text


def on_post_page(output: str, **_: Any) -> str:
    """Give a name to the theme's search, which has the role of a dialog but no name."""
    return output.replace(_SEARCH, f'{_SEARCH} aria-label="Search"')


def _fence(found: re.Match[str]) -> str:
    title = re.fullmatch(r"title=(\S+)", found["info"])
    return f"{found['ticks']}{found['language']}" + (f' title="{title[1]}"' if title else "")

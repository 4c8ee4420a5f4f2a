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
"""Lint for the prose of code and documentation: `python -m tools.prose_lint [PATH ...]` lists prose that is not plain.

It checks what can be counted:

- `head`: the first words of docstrings. Modules and classes begin with a noun phrase, functions with an imperative;
  no docstring, of a test or an attribute either, begins with a word of `NEVER_FIRST`.
- `help`: options without help text, and help texts that begin with a preposition, a relative or a finite verb.
- `phrase`: expressions of `PHRASES` in docstrings, comments, messages, help texts and documentation.
- `history`: comments about earlier versions of the code.
- `length`: sentences of docstrings and pages with more than 40 words, and pages whose median exceeds 18 words.
- `chain`: sentences joined by two or more semicolons.
- `name`: classes, functions and constants with a name of `NAMES`.

The exit code is 1 if there is a finding. `EXCEPTIONS` lists the accepted ones.
"""

from __future__ import annotations

import argparse
import ast
import inspect
import io
import re
import statistics
import subprocess
import sys
import tokenize
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import attrs
from markdown_it import MarkdownIt

from tools.syntax_trees import walk

ROOT = Path(__file__).parents[1]
LONGEST, MEDIAN = 40, 18  # words of a sentence

# --- Exceptions: file and a part of the finding, with the reason ------------------------------------------------------
EXCEPTIONS: dict[tuple[str, str], str] = {
    ("tools/prose_lint.py", ""): "the patterns themselves",
    ("test/test_prose_lint.py", ""): "examples of findings",
}


# --- Vocabulary -------------------------------------------------------------------------------------------------------
def words(text: str) -> set[str]:
    """Return the words of a text as a set."""
    return set(text.split())


NEVER_FIRST = words("by from how of what when where whether which who whatever")  # of any docstring, also in tests
RELATIVES = words("what which who whom whose how where when why that")
CONJUNCTIONS = words("and as because but if or so than then though unless while whatever")
PREPOSITIONS = words("""
    about above after against along among around at before behind below beneath beside between beyond by down during for
    from in inside into like near of off on onto out outside over past since through till to toward under until up upon
    via with within without""")
PRONOUNS = words("""
    he her his i it me my our ours she their them they us we you your anybody anyone anything everybody everyone
    everything nobody none nothing somebody someone something whoever""")
AUXILIARIES = words("""
    am are be been can could did do does had has have is may might must shall should was were will would""")
DETERMINERS = words("a an the this these its each every all any one two both whether")
HEADLESS = RELATIVES | CONJUNCTIONS | PREPOSITIONS | PRONOUNS | AUXILIARIES | {"whether"}
# verbs that a docstring of a module or a class could begin with
IMPERATIVES = words("""
    analyse build call check compare compute draw evaluate fit give guess hold hurt import keep let list look make
    measure parse play predict print prove put read run seek send serve show start take test turn watch write""")
# everyday verbs that would have a private meaning
PRIVATE = words("be come go hear look rest say speak tell")

PHRASES = [
    "anew", "nobody", "somebody", "whoever", "anybody", "everybody", "in force", "in words",
    "(?:is|are|was|were|be) (?:told|said)", "told of", "told about", "what is none", "what is not one",
    r"(?<!there )(?-i:is none)\b(?! of)", r"freewheel\w*", "beyond all measure", "(?:is|are|written) whole",
    "(?:goes|go|went) out", "stands there", r"dents?\b(?! of)", "unhurried", "heard of", "(?:is|are) heard", "hears",
    "amid", "albeit", "hence", "hitherto", "lest", "thence", "thereby", "thereof", "therein", "whence", "whereof",
]  # fmt: skip
HISTORY = [
    "no longer", "used to", "formerly", "(?:first|earlier|previous) version", "originally", "until now", "any ?more",
    "once was", "was once", "has been renamed", "in the past", "historically", "before this change",
]  # fmt: skip
NAMES = words("""
    Apparatus Wire OverTopics InProcess RecordedInProcess Ladder Rung climb Walk News Note hear rest Look Own Spending
    Foreign Trouble Quiet Replan Keyed Portable held unhurried be_gentle written_whole errors_as obstacle GLANCE_S
    PEEK_S DEAF_S LOOK_S MOST_BAD HURRIED dent FREEWHEEL freewheel""")
PHRASE = re.compile(rf"\b(?:{'|'.join(PHRASES)})\b", re.IGNORECASE)
PAST = re.compile(rf"\b(?:{'|'.join(HISTORY)})\b", re.IGNORECASE)

MARKDOWN = MarkdownIt("commonmark").enable("table")
WORD = re.compile(r"[^\W_][\w'’.-]*")
SENTENCE = re.compile(r"(?<=[.!?])[\"')\]]*\s+(?=[^\W\d_]|[`*\[\"'(])")


@attrs.frozen
class Finding:
    """Violation of one rule at one line of a file."""

    file: str
    line: int
    rule: str
    text: str

    def __str__(self) -> str:
        return f"{self.file}:{self.line}: {self.rule}: {self.text}"


# --- Sentences --------------------------------------------------------------------------------------------------------
def sentences(text: str) -> Iterator[str]:
    """Yield the sentences of prose; inline code counts as one word, indented blocks and lists end a sentence."""
    text = re.sub(r"\n(?:\n(?: {4}.*\n?)+)+", "\n\n", text)  # without literal blocks
    text = re.sub(r"``?[^`]+``?", "Code", text)
    for paragraph in re.split(r"\n\s*\n|\n\s*(?:[-*|]|\d+\.)\s|\n\s+\w+(?:, \w+)*: ", text):
        yield from (part for part in SENTENCE.split(" ".join(paragraph.split())) if part)


def of_sentence(file: str, line: int, sentence: str) -> Iterator[Finding]:
    """Yield the findings about the length and the punctuation of one sentence."""
    if (count := len(WORD.findall(sentence))) > LONGEST:
        yield Finding(file, line, "length", f"{count} words: {sentence[:60]} …")
    if sentence.count("; ") >= 2:
        yield Finding(file, line, "chain", sentence[:70])


def of_phrases(file: str, line: int, text: str) -> Iterator[Finding]:
    """Yield the rejected phrases of a text, each with the line it is in."""
    for hit in PHRASE.finditer(re.sub(r"`[^`\n]+`", lambda code: "·" * len(code.group()), text)):
        yield Finding(file, line + text.count("\n", 0, hit.start()), "phrase", hit.group())


# --- Python -----------------------------------------------------------------------------------------------------------
def is_noun_phrase(line: str) -> bool:
    """Return whether the first line of a docstring of a module or a class can be a noun phrase."""
    first, second = ([*(word.lower() for word in re.findall(r"[\w'’-]+", line)), "", ""])[:2]
    if first in HEADLESS or (first in {"all", "one", "some", "a", "the"} and second in RELATIVES | PREPOSITIONS):
        return False
    follows = second in DETERMINERS | RELATIVES | PRONOUNS | {"back", "from", "into", "together"}
    return not (follows and (first in IMPERATIVES or (first.endswith("s") and first not in {"this", "as"})))


def is_imperative(line: str) -> bool:
    """Return whether the first line of a function's docstring can begin with an imperative verb."""
    first, second = ([*(word.lower() for word in re.findall(r"[\w'’-]+", line)), "", ""])[:2]
    if first in HEADLESS - {"do"} | DETERMINERS | PRIVATE:
        return False
    return first != "return" or second not in {"what", "who", "where"}


LOOKED_AT = (
    ast.Module,
    ast.ClassDef,
    ast.FunctionDef,
    ast.AsyncFunctionDef,
    ast.Expr,
    ast.JoinedStr,
    ast.Constant,
    ast.Call,
)
"""Kinds of syntax that the checks below look at: one pass over the tree finds them for all."""


def docstrings(nodes: Sequence[ast.AST]) -> Iterator[tuple[ast.AST, ast.Expr]]:
    """Yield each docstring with its module, class, function or assignment."""
    for node in nodes:
        body = node.body if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) else []
        for subject, one in zip([node, *body], body, strict=False):
            documented = subject is node or isinstance(subject, ast.Assign | ast.AnnAssign)
            if documented and isinstance(one, ast.Expr) and isinstance(one.value, ast.Constant):
                yield subject, one


def of_docstrings(file: str, nodes: Sequence[ast.AST], *, heads: bool) -> Iterator[Finding]:
    """Yield the findings about the docstrings of a module."""
    for subject, node in docstrings(nodes):
        text = inspect.cleandoc(str(ast.literal_eval(node.value)))
        first = text.split("\n", maxsplit=1)[0]
        decorators = " ".join(ast.unparse(one) for one in getattr(subject, "decorator_list", ()))
        good = first.partition(" ")[0].lower() not in NEVER_FIRST
        if heads and (isinstance(subject, ast.Module | ast.ClassDef) or "property" in decorators):
            good = is_noun_phrase(first) or first.startswith("`python")
        elif heads and isinstance(subject, ast.FunctionDef | ast.AsyncFunctionDef):
            good = is_imperative(first)
        if not good:
            yield Finding(file, node.lineno, "head", first[:80])
        yield from of_phrases(file, node.lineno, text)
        for sentence in sentences(text):
            yield from of_sentence(file, node.lineno, sentence)


def of_strings(file: str, nodes: Sequence[ast.AST]) -> Iterator[Finding]:
    """Yield the rejected phrases of messages, help texts and labels: all strings of several words."""
    inner: set[ast.AST] = set()  # docstrings, and the parts of f-strings
    for node in nodes:
        if isinstance(node, ast.JoinedStr):
            inner.update(node.values)
            text = "".join(str(part.value) if isinstance(part, ast.Constant) else "·" for part in node.values)
        elif isinstance(node, ast.Expr):
            inner.add(node.value)
            continue
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and node not in inner:
            text = node.value
        else:
            continue
        if " " in text and "\n" not in text:
            yield from of_phrases(file, node.lineno, text)


def of_help(file: str, nodes: Sequence[ast.AST]) -> Iterator[Finding]:
    """Yield the options of command lines without a help text or with one that is no noun phrase or instruction."""
    for node in nodes:
        name = node.func.attr if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute) else ""
        if not isinstance(node, ast.Call) or name not in {"add_argument", "add_parser"}:
            continue
        given = {one.arg: one.value for one in node.keywords}
        if None in given:
            continue
        subject = ast.unparse(node.args[0]) if node.args else name
        if "help" not in given:
            yield Finding(file, node.lineno, "help", f"{subject} has no help")
            continue
        parts = [one for one in ast.walk(given["help"]) if isinstance(one, ast.Constant) and isinstance(one.value, str)]
        for text in (one.value for one in parts if " " in one.value.strip() and one is parts[0]):
            first, second = ([*(word.lower() for word in re.findall(r"[\w'’-]+", text)), "", ""])[:2]
            finite = first.endswith("s") and second in DETERMINERS
            if first in HEADLESS - {"do"} | PRIVATE or finite:
                yield Finding(file, node.lineno, "help", f"{subject}: {text[:60]}")


def of_comments(file: str, source: str) -> Iterator[Finding]:
    """Yield the rejected phrases and the history in comments."""
    marked = "\n".join(line[line.index("#") :] for line in source.splitlines() if "#" in line)
    if not (PHRASE.search(marked) or PAST.search(marked)):
        return  # reading a file's tokens takes ten times as long
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT:
            yield from of_phrases(file, token.start[0], token.string)
            for hit in PAST.finditer(token.string):
                yield Finding(file, token.start[0], "history", token.string[max(0, hit.start() - 30) : hit.end() + 30])


def of_names(file: str, tree: ast.Module, nodes: Sequence[ast.AST]) -> Iterator[Finding]:
    """Yield the functions, classes and constants of a module with a rejected name."""
    for node in nodes:
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and node.name in NAMES:
            yield Finding(file, node.lineno, "name", node.name)
    for statement in tree.body:
        for target in statement.targets if isinstance(statement, ast.Assign) else ():
            if isinstance(target, ast.Name) and target.id in NAMES:
                yield Finding(file, target.lineno, "name", target.id)


def of_python(file: str, source: str) -> Iterator[Finding]:
    """Yield the findings of a Python file; tests and examples may begin a docstring with a sentence."""
    tree = ast.parse(source)
    nodes = [node for node in walk(tree) if isinstance(node, LOOKED_AT)]
    yield from of_docstrings(file, nodes, heads=not file.startswith(("test/", "examples/")))
    yield from of_strings(file, nodes)
    yield from of_help(file, nodes)
    yield from of_comments(file, source)
    yield from of_names(file, tree, nodes)


# --- Pages ------------------------------------------------------------------------------------------------------------
def of_page(file: str, source: str) -> Iterator[Finding]:
    """Yield the findings of a Markdown page: phrases, long sentences and a median above the limit."""
    counts = []
    table = 0
    line = 1
    for token in MARKDOWN.parse(source):
        table += {"table_open": 1, "table_close": -1}.get(token.type, 0)
        line = token.map[0] + 1 if token.map else line
        if token.type != "inline" or not token.children:
            continue
        prose = "".join(
            "Code" if child.type == "code_inline" else child.content if child.type == "text" else " "
            for child in token.children
        )
        yield from of_phrases(file, line, prose)
        for sentence in sentences(prose):
            if re.search(r"[.!?:]$", sentence) or len(WORD.findall(sentence)) > LONGEST:
                yield from of_sentence(file, line, sentence)
                if not table:
                    counts.append(len(WORD.findall(sentence)))
    if counts and (median := statistics.median(counts)) > MEDIAN:
        yield Finding(file, 1, "length", f"median of {median:g} words a sentence, at most {MEDIAN}")


def findings(files: Iterable[str]) -> Iterator[Finding]:
    """Yield the findings of some files of the repository, without the exceptions."""
    for file in files:
        source = (ROOT / file).read_text(encoding="utf-8")
        if file.endswith(".py"):
            found = of_python(file, source)
        elif file.endswith(".md"):
            found = of_page(file, source)
        else:
            found = of_phrases(file, 1, source)
        yield from (one for one in found if not any(file == path and text in one.text for path, text in EXCEPTIONS))


def main() -> int:
    """Print the findings, and return 1 if there are any."""
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n", maxsplit=1)[0])
    parser.add_argument("paths", nargs="*", help="files and folders to check (default: the repository)")
    paths = tuple(parser.parse_args().paths or [""])
    kinds = ("*.py", "*.md", "*.js", "*.mjs", "*.html", "*.sh", "*.c", "*.h", "*.yaml", "*.toml", "*.rst", "Makefile")
    command = ["git", "ls-files", *kinds, "*/words.json"]
    listed = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout  # noqa: S603  # git
    found = list(findings(one for one in listed.split() if one.startswith(paths) and not one.startswith("test/data/")))
    print(*found, sep="\n", end="\n" if found else "")  # noqa: T201  # a program
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())

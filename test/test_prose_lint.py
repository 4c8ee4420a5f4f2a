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
"""Decisions of the prose lint: what it accepts and what it rejects."""

import ast

import pytest

from tools import prose_lint

FIRST_LINES = [
    (prose_lint.is_noun_phrase, True, "Flow control for `daq/scan`."),
    (prose_lint.is_noun_phrase, True, "Readers of one run."),
    (prose_lint.is_noun_phrase, True, "Run and report of a job."),
    (prose_lint.is_noun_phrase, False, "What a job gave."),
    (prose_lint.is_noun_phrase, False, "Gives back the messages of a run."),
    (prose_lint.is_noun_phrase, False, "Reads a file."),
    (prose_lint.is_noun_phrase, False, "One that waits."),
    (prose_lint.is_noun_phrase, False, "Of a node: its topics."),
    (prose_lint.is_noun_phrase, False, "Everything about a topic."),
    (prose_lint.is_imperative, True, "Decode a received table."),
    (prose_lint.is_imperative, True, "Return whether the rig is ready."),
    (prose_lint.is_imperative, True, "Return how many scans were lost."),
    (prose_lint.is_imperative, False, "Return what was lost."),
    (prose_lint.is_imperative, False, "Whether the rig is ready."),
    (prose_lint.is_imperative, False, "A decoded table."),
    (prose_lint.is_imperative, False, "Hear from a peer."),
]


@pytest.mark.parametrize(("check", "good", "line"), FIRST_LINES)
def test_a_class_begins_with_a_noun_phrase_and_a_function_with_an_imperative(check, good, line):
    assert check(line) is good


@pytest.mark.parametrize(
    ("line", "count"),
    [("Number of scans.", 0), ("Return whether the rig is ready.", 0), ("Whether the rig is ready.", 1)],
)
def test_a_property_begins_with_a_noun_phrase_or_with_return(line, count):
    tree = ast.parse(f'@property\ndef one(self):\n    """{line}"""')
    assert len(list(prose_lint.of_docstrings("x.py", list(ast.walk(tree)), heads=True))) == count


@pytest.mark.parametrize(
    "template",
    [
        '"""{}"""',
        'class A:\n    """{}"""',
        'def test_a():\n    """{}"""',
        'A = 1\n"""{}"""',
        'class A:\n    a: int\n    """{}"""',
    ],
)
@pytest.mark.parametrize(
    ("line", "count"),
    [
        ("Scans of a block.", 0),
        *((f"{word} a scan is lost.", 1) for word in ("Whether", "Of", "From", "When", "Which")),
    ],
)
def test_no_docstring_of_a_test_or_an_attribute_begins_with_a_question(template, line, count):
    found = prose_lint.of_python("test/x.py", template.format(line))
    assert [one.rule for one in found] == ["head"] * count


@pytest.mark.parametrize(
    ("option", "count"),
    [
        (', help="number of frames to average"', 0),
        (', help="that are averaged"', 1),
        (', help="of the rig; default: the paper\'s"', 1),
        ("", 1),
    ],
)
def test_an_option_has_a_help_text_that_is_a_noun_phrase(option, count):
    tree = ast.parse(f'parser.add_argument("--frames"{option})')
    assert len(list(prose_lint.of_help("x.py", list(ast.walk(tree))))) == count


def test_phrases_are_found_in_comments_messages_and_docstrings_but_not_in_code():
    source = 'def run():\n    """Wait for `nobody`.\n\n    Nobody listens."""\n    raise E("begins anew")  # in force\n'
    found = [(one.line, one.text.lower()) for one in prose_lint.of_python("test/x.py", source)]
    assert found == [(4, "nobody"), (5, "anew"), (5, "in force")]


def test_history_is_found_in_comments_only():
    source = 'x = "no longer"  # the first version had two\n'
    assert [one.rule for one in prose_lint.of_python("test/x.py", source)] == ["history"]


def test_consecutive_literal_blocks_are_not_prose():
    block = "\n    >>> " + "word " * 60 + "\n"
    assert not [one for one in prose_lint.sentences(f"Say it.\n{block}{block}") if "word" in one]


def test_a_page_has_short_sentences():
    short, long = "The rig waits for the reader. ", f"The rig {'very ' * 40}slowly waits. "
    assert not list(prose_lint.of_page("x.md", f"# Title\n\n{short * 9}\n"))
    assert [one.rule for one in prose_lint.of_page("x.md", short * 9 + long)] == ["length"]
    medium = f"The rig {'very ' * 20}slowly waits. "
    assert "median" in next(iter(prose_lint.of_page("x.md", medium * 3))).text

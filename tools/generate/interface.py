# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The tables of `docs/interface.md`: topics, columns, services, parameters, figures, states."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any  # settings of any node

import numpy as np

from impact_rig import states, topics
from impact_rig.blocks import TEXT, Column
from impact_rig.config import FieldInfo
from impact_rig.config.tree import Tree, Value
from impact_rig.instruments import section
from impact_rig.instruments.instrument import FAULT_KINDS
from impact_rig.nodes.analysis_node import AnalysisSettings
from impact_rig.nodes.messages import ENVELOPES, SPECTRA, TOPICS
from impact_rig.nodes.recorder_node import RecorderSettings
from impact_rig.nodes.stepped_sine_node import SteppedSineSettings
from impact_rig.rig import takes_effect
from impact_rig.rig.config import TREE
from impact_rig.rig.journal import Kind
from tools.generate import figures, services
from tools.generate.markdown import table
from tools.generate.nominal import scalar
from tools.generate.services import Situation

SCHEMAS: dict[str, Tree[Any]] = {
    "rig": TREE,
    "analysis": Tree(AnalysisSettings),
    "recorder": Tree(RecorderSettings),
    "stepped_sine": Tree(SteppedSineSettings),
}


def _shown_topics() -> list[topics.Topic]:
    """Return the topics of the page: one row stands for all envelopes and one for all spectra."""
    shown: list[topics.Topic] = []
    for family, general in (
        (ENVELOPES, topics.envelope("CHANNEL", "as the channel")),
        (SPECTRA, topics.spectrum("CHANNEL", "as the channel")),
    ):
        shown += [general] * bool(family)
    alike = {topic.name for topic in (*ENVELOPES.values(), *SPECTRA.values())}
    first = next(number for number, topic in enumerate(TOPICS) if topic.name in alike)
    others = [topic for topic in TOPICS if topic.name not in alike]
    return [*others[:first], *shown, *others[first:]]


def _topics() -> str:
    rows = (
        (f"`{t.name}`", t.type_name.split("/")[-1], t.publisher, t.qos.name, t.frame_id or "-", t.doc)
        for t in _shown_topics()
    )
    return table(("topic", "type", "published by", "QoS", "frame", "content"), rows)


def _qualities() -> str:
    rows = (
        (q.name, "reliable", str(q.depth), "transient local" if q.transient_local else "volatile") for q in topics.Qos
    )
    return table(("QoS", "reliability", "keep last", "durability"), rows)


def _columns() -> str:
    titles: dict[tuple[Column, ...], list[str]] = {}
    for topic in TOPICS:
        if topic.columns is not None:
            titles.setdefault(topic.fields, []).append(f"`{topic.name}`")
    parts = []
    for fields, names in titles.items():
        begun = [earlier for earlier in titles if fields != earlier and fields[: len(earlier)] == earlier]
        same = f"The columns of {titles[begun[0]][0]}, and\n\n" if begun else ""
        columns = section.COLUMNS if f"`{topics.SCAN.name}`" in names else fields[len(begun[0]) :] if begun else fields
        rows = ((f"`{c.name}`", _kind(c.kind), c.unit, c.doc) for c in columns)
        parts.append(f"### {', '.join(names)}\n\n{same}" + table(("column", "type", "unit", "meaning"), rows))
    return "\n".join(parts)


def _fields() -> str:
    shown = [topic for topic in _shown_topics() if topic.columns is None]
    for earlier, topic in itertools.pairwise(shown[:]):  # pulses are an envelope, too
        if [(c.name, c.doc) for c in topic.fields] == [(c.name, c.doc) for c in earlier.fields]:
            shown.remove(earlier)
    rows = ((f"`{t.name}`", f"`{c.name}`", c.unit, c.doc) for t in shown for c in t.fields)
    return table(("topic", "field", "unit", "meaning"), rows)


def _kind(code: str) -> str:
    if code == TEXT:
        return "UINT8 × 32"
    kind = np.dtype(code)
    return {"f": "FLOAT", "i": "INT", "u": "UINT"}[kind.kind] + str(8 * kind.itemsize)


def _journal() -> str:
    return table(("kind", "meaning"), ((f"`{kind.value}`", kind.doc) for kind in Kind))


def _faults() -> str:
    return table(("kind", "meaning"), ((f"`{kind}`", doc) for kind, doc in FAULT_KINDS.items()))


def _services() -> str:
    rows = ((f"`{s.node}{s.name[1:]}`", s.type_name.split("/")[-1], s.doc) for s in services.SERVICES)
    return table(("service", "type", "what it does"), rows)


def _states() -> str:
    inputs = [row for row in (*services.COMMANDS, *services.SERVICES) if row.node == "rig"]
    shown = [situation for situation in Situation if any(situation in row.taken for row in inputs)]
    rows = ((f"`{i.name}`", *("taken" if s in i.taken else "refused" for s in shown)) for i in inputs)
    return table(("input of the rig", *(s.value for s in shown)), rows)


def _parameters(node: str) -> Callable[[], str]:
    def parameters() -> str:
        heads = ["parameter", "default", "unit", "range", "origin", "meaning"]
        rows = []
        for name, about, default in SCHEMAS[node].fields():
            legal = about.range_text() if _limited(about) else _type(default)
            row = [f"`{name}`", f"`{_shown(default)}`", about.unit, legal, about.origin.value, about.doc]
            rows.append([*row, "start only" if about.read_only else takes_effect(name)] if node == "rig" else row)
        return table([*heads, "acts from"] if node == "rig" else heads, rows)

    return parameters


def _limited(about: FieldInfo) -> bool:
    return bool(about.choices) or about.low is not None or about.high is not None


def _shown(value: Value) -> str:
    return scalar(value)


def _type(value: Value) -> str:
    return {bool: "true or false", str: "any text", tuple: "list of texts"}.get(type(value), "any finite number")


def _figures() -> str:
    rows = (
        (node, f"`{figure.key}`", figure.unit, figure.doc)
        for node, known in figures.FIGURES.items()
        for figure in known
    )
    return table(("node", "figure", "unit", "meaning"), rows)


def _words() -> str:
    rows = ((node, f"`{word.value}`", f"{word.doc}.") for node, words in states.BY_NODE.items() for word in words)
    return table(("node", "state", "meaning"), rows)


TABLES: dict[str, Callable[[], str]] = {
    "topics": _topics,
    "qualities of service": _qualities,
    "columns": _columns,
    "fields": _fields,
    "journal": _journal,
    "faults": _faults,
    "services": _services,
    "states": _states,
    "rig parameters": _parameters("rig"),
    "analysis parameters": _parameters("analysis"),
    "recorder parameters": _parameters("recorder"),
    "stepped_sine parameters": _parameters("stepped_sine"),
    "figures": _figures,
    "words": _words,
}
"""Name in the page's markers -> its text."""

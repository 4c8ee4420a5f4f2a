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
"""The interface as the tables of `docs/reference/interface.md` and as the document of `impact-rig interface`."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Callable
from typing import Any  # settings of any node

import numpy as np

from impact_rig import graph, states, topics
from impact_rig.blocks import TEXT, Column
from impact_rig.cli.interface import CLIENTS
from impact_rig.config import FieldInfo
from impact_rig.config.tree import Tree, Value
from impact_rig.graph import Situation
from impact_rig.instruments import section
from impact_rig.instruments.instrument import FAULT_KINDS
from impact_rig.nodes.analysis_node import AnalysisSettings
from impact_rig.nodes.messages import ENVELOPES, SPECTRA, TOPICS
from impact_rig.nodes.plot_node import PlotSettings
from impact_rig.nodes.recorder_node import RecorderSettings
from impact_rig.recording import description
from impact_rig.rig import takes_effect
from impact_rig.rig.config import TREE
from impact_rig.rig.journal import InputKind
from impact_rig_studies.stepped_sine_node import SteppedSineSettings
from tools.generate import figures
from tools.generate.markdown import table
from tools.generate.nominal import scalar

SCHEMAS: dict[str, Tree[Any]] = {
    "rig": TREE,
    "analysis": Tree(AnalysisSettings),
    "recorder": Tree(RecorderSettings),
    "plot": Tree(PlotSettings),
    "stepped_sine": Tree(SteppedSineSettings),
}


def _shown_topics() -> list[topics.Topic]:
    """Return the topics of the page: one row stands for all envelopes and one for all spectra."""
    families = ((ENVELOPES, topics.envelope), (SPECTRA, topics.spectrum))
    shown = [general("CHANNEL", "as the channel") for family, general in families if family]
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
        heads = [earlier for earlier in titles if fields != earlier and fields[: len(earlier)] == earlier]
        same = f"The columns of {titles[heads[0]][0]}, and\n\n" if heads else ""
        columns = section.COLUMNS if f"`{topics.SCAN.name}`" in names else fields[len(heads[0]) :] if heads else fields
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


def _services() -> str:
    rows = ((f"`{s.node}{s.name[1:]}`", s.type_name.split("/")[-1], s.doc) for s in graph.SERVICES)
    return table(("service", "type", "effect"), rows)


def _nodes() -> str:
    """Return the table of each node's subscriptions; its publications are in the table of topics."""

    def listed(names: list[str]) -> str:
        return ", ".join(f"`{name}`" for name in names) or "-"

    def subscribed(node: graph.Node) -> str:
        names = listed([*node.subscribes, *([] if node.makes_time else [topics.CLOCK.name])])
        return f"{names}, every recorded topic" if node.subscribes_recorded else names

    rows = ((f"`{n.name}`", f"`{n.program}`", subscribed(n), listed(list(n.publishes))) for n in graph.NODES)
    return table(("node", "program", "subscribes to", "also publishes"), rows)


def _states() -> str:
    inputs = [row for row in (*graph.COMMANDS, *graph.SERVICES) if row.node == "rig"]
    shown = [situation for situation in Situation if any(situation in row.taken for row in inputs)]
    rows = ((f"`{i.name}`", *("taken" if s in i.taken else "refused" for s in shown)) for i in inputs)
    return table(("input of the rig", *(s.value for s in shown)), rows)


def _parameters(node: str) -> Callable[[], str]:
    def parameters() -> str:
        heads = ["parameter", "default", "unit", "range", "origin", "meaning"]
        types: dict[type, str] = {bool: "true or false", str: "any text", tuple: "list of texts"}
        rows = []
        for name, about, default in SCHEMAS[node].fields():
            limited = about.choices or about.low is not None or about.high is not None
            legal = about.range_text() if limited else types.get(type(default), "any finite number")
            row = [f"`{name}`", f"`{scalar(default)}`", about.unit, legal, about.origin.value, about.doc]
            rows.append([*row, "start only" if about.read_only else takes_effect(name)] if node == "rig" else row)
        return table([*heads, "acts from"] if node == "rig" else heads, rows)

    return parameters


def _figures() -> str:
    rows = (
        (node, f"`{figure.key}`", figure.unit, figure.doc)
        for node, known in figures.FIGURES.items()
        for figure in known
    )
    return table(("node", "figure", "unit", "meaning"), rows)


def document() -> str:
    """Return topics, services and parameters as JSON, one row per line, without empty members."""
    content = {
        "topics": {topic.name: _topic(topic) for topic in TOPICS},
        "services": {f"{s.node}{s.name[1:]}": {"type": s.type_name, "doc": s.doc} for s in graph.SERVICES},
        "nodes": {
            node.name: {
                "publishes": node.published(TOPICS), "subscribes": node.subscribed(TOPICS), "services": node.services(),
            }
            for node in graph.NODES
        },
        "parameters": {
            node: {name: _parameter(about, default) for name, about, default in tree.fields()}
            for node, tree in SCHEMAS.items()
        },
    }  # fmt: skip
    return _text(content) + "\n"


def definitions() -> str:
    """Return the `.msg` texts of all topics as JSON, for installations without ROS 2."""
    texts = {name: text for topic in TOPICS for name, text in description.definitions(topic.type_name).items()}
    return json.dumps(texts, indent=1, sort_keys=True, ensure_ascii=False) + "\n"


def _topic(topic: topics.Topic) -> dict[str, object]:
    taken = topic.publisher in CLIENTS
    columns = section.COLUMNS if topic is topics.SCAN else topic.fields
    return {
        "type": topic.type_name, "publisher": topic.publisher, "reliability": "reliable", "depth": topic.qos.depth,
        "durability": "transient local" if topic.qos.transient_local else "volatile", "frame": topic.frame_id,
        "doc": topic.doc,
        "columns": {
            column.name: _said(
                type="" if topic.columns is None else _kind(column.kind), unit=column.unit, whole=column.whole,
                least=column.least, most=column.most, required=taken and column.default is None, doc=column.doc,
            )
            for column in columns
        },
    }  # fmt: skip


def _parameter(about: FieldInfo, default: Value) -> dict[str, object]:
    types = {bool: "bool", int: "integer", float: "double", str: "string"}
    one = types[type(default[0]) if isinstance(default, tuple) and default else str]
    said = _said(
        type=f"{one}_array" if isinstance(default, tuple) else types[type(default)], unit=about.unit,
        least=about.low, least_open=about.low_open, most=about.high, most_open=about.high_open,
        choices=list(about.choices), pattern=about.pattern, start_only=about.read_only, doc=about.doc,
    )  # fmt: skip
    return {"default": list(default) if isinstance(default, tuple) else default, **said}


def _said(**row: object) -> dict[str, object]:
    """Leave out members without meaning: empty text, missing bound, false."""
    nothing = ("", "-", None, [], math.inf, -math.inf)
    return {key: value for key, value in row.items() if value is not False and value not in nothing}


def _text(tree: dict[str, Any], depth: int = 0) -> str:
    """Return a tree as JSON, with a row that has no further rows in one line."""
    if not any(isinstance(value, dict) for value in tree.values()):
        return json.dumps(tree, ensure_ascii=False)
    inner = (
        f"{' ' * (depth + 1)}{json.dumps(key)}: "
        + (_text(value, depth + 1) if isinstance(value, dict) else json.dumps(value, ensure_ascii=False))
        for key, value in tree.items()
    )
    return "{\n" + ",\n".join(inner) + f"\n{' ' * depth}}}"


TABLES: dict[str, Callable[[], str]] = {
    "topics": _topics,
    "qualities of service": _qualities,
    "columns": _columns,
    "fields": _fields,
    "journal": lambda: table(("kind", "meaning"), ((f"`{kind.value}`", kind.doc) for kind in InputKind)),
    "faults": lambda: table(("kind", "meaning"), ((f"`{kind}`", doc) for kind, doc in FAULT_KINDS.items())),
    "services": _services,
    "nodes": _nodes,
    "states": _states,
    "rig parameters": _parameters("rig"),
    "analysis parameters": _parameters("analysis"),
    "recorder parameters": _parameters("recorder"),
    "plot parameters": _parameters("plot"),
    "stepped_sine parameters": _parameters("stepped_sine"),
    "figures": _figures,
    "words": lambda: table(
        ("node", "state", "meaning"),
        ((node, f"`{word.value}`", f"{word.doc}.") for node, words in states.BY_NODE.items() for word in words),
    ),
}
"""Name in the page's markers -> function that returns the text."""

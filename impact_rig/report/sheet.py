# Copyright 2026 The impact_rig developers
# SPDX-License-Identifier: Apache-2.0
"""The look of the page: it follows the theme, fits a phone, and prints on A4 with a cover and whole figures."""

from __future__ import annotations

from impact_rig.drawing.palette import variables

_LIGHT = "--page: #ffffff; --good: #17692f; --bad: #b30f1b; --soft: #f3f5f8; --quietly: #59636e; "
_DARK = "--page: #14181d; --good: #4ac26b; --bad: #ff6b6b; --soft: #1d232a; --quietly: #a9b3be; "

STYLE = """
:root { color-scheme: light dark; LIGHT }
@media (prefers-color-scheme: dark) { :root { DARK } }
@media print { :root { color-scheme: light; LIGHT } }
* { box-sizing: border-box; }
html { scroll-padding-top: 1rem; }
body { margin: 0 auto; padding: 1rem; max-width: 80rem; background: var(--page); color: var(--ink);
  font: 16px/1.5 system-ui, sans-serif; overflow-wrap: break-word; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .5rem 0; } h2 { font-size: 1.25rem; margin: 2.4rem 0 .6rem; }
h3 { font-size: 1rem; margin: 1.4rem 0 .4rem; }
p { max-width: 48rem; } a { color: var(--s0); } .muted { color: var(--quietly); }
dl.cover { display: grid; grid-template-columns: max-content 1fr; gap: .2rem 1.2rem; margin: 1rem 0; max-width: 60rem;
  padding: 1rem 1.2rem; border: 1px solid var(--grid); border-radius: .5rem; }
dl.cover dt { color: var(--quietly); } dl.cover dd { margin: 0; min-width: 0; }
nav ol { columns: 18rem; padding-left: 1.6rem; margin: .4rem 0; } nav li { break-inside: avoid; }
.figures { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 24rem), 1fr)); gap: 1rem 1.5rem; }
figure { margin: 0; min-width: 0; max-width: 34rem; } figure svg { display: block; width: 100%; height: auto; }
.figures.large { grid-template-columns: repeat(auto-fill, minmax(min(100%, 30rem), 1fr)); }
.figures.large figure { max-width: 40rem; }
figure svg text { font-family: "DejaVu Sans", Verdana, Geneva, sans-serif !important; }
figcaption { font-size: .85rem; color: var(--quietly); }
figcaption a { display: inline-block; padding: .15rem .4rem; } figcaption a.back { display: none; }
.figures figure:target { position: fixed; inset: 0; z-index: 9; max-width: none; padding: 1rem; overflow: auto;
  background: var(--page); }
figure:target svg { width: min(95vw, 80rem); max-width: none; height: auto; margin: 0 auto; }
figure:target a.back { display: inline-block; position: fixed; top: .6rem; right: 1rem; background: var(--soft); }
figure:target a.enlarge { display: none; }
.scroll { overflow-x: auto; } table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .25rem .7rem; text-align: left; vertical-align: top; border-bottom: 1px solid var(--grid); }
th { font-size: .85rem; color: var(--quietly); font-weight: 600; }
td.n, th.n { text-align: right; } td.n { white-space: nowrap; }
.pass { color: var(--good); font-weight: 600; } .FAIL { color: var(--bad); font-weight: 600; }
.tiles { display: grid; grid-template-columns: repeat(auto-fill, minmax(10rem, 1fr)); gap: .7rem; margin: 1rem 0; }
.tile { background: var(--soft); border-radius: .5rem; padding: .6rem .8rem; }
.tile b { display: block; font-size: 1.3rem; }
details summary { cursor: pointer; padding: .3rem 0; }
@media screen and (max-width: 40rem) {
  dl.cover { grid-template-columns: 1fr; gap: 0; padding: .7rem .9rem; } dl.cover dt { margin-top: .4rem; }
  figure:target svg { width: 200vw; }
  table, tbody, tr, td { display: block; } thead { position: absolute; left: -99rem; }
  tr { padding: .4rem 0; border-bottom: 1px solid var(--grid); }
  td, td.n { display: grid; grid-template-columns: 9.5rem 1fr; gap: .6rem; padding: .1rem 0; border: 0;
    text-align: left; white-space: normal; min-width: 0; }
  td::before { content: attr(data-label); color: var(--quietly); font-size: .85rem; }
  td:empty { display: none; } td { overflow-wrap: anywhere; }
}
@page { size: A4; margin: 16mm 14mm 18mm; @bottom-right { content: counter(page) " / " counter(pages);
  font: 9px sans-serif; } }
@media print {
  body { font-size: 10.5px; padding: 0; max-width: none; } h1 { font-size: 20px; } h2 { font-size: 14px; }
  h2, h3 { break-after: avoid; } figure, tr, .tile, dl { break-inside: avoid; } thead { display: table-header-group; }
  section.part { break-before: page; } section { orphans: 3; widows: 3; }
  .figures { grid-template-columns: 1fr 1fr; gap: 5mm; } figure { max-width: none; }
  .figures.large { grid-template-columns: 1fr 1fr; } figcaption { font-size: 9px; }
  .scroll { overflow: visible; } table, th { font-size: 9px; }
  th, td { padding: 1px 5px; } td.n { white-space: normal; }
  figcaption a { display: none !important; } a { color: inherit; text-decoration: none; }
  details > summary { list-style: none; font-weight: 600; }
  details::details-content { content-visibility: visible; block-size: auto; display: block; }
  .figures figure:target { position: static; padding: 0; } figure:target svg { height: auto; width: 100%; }
}
""".replace("LIGHT", _LIGHT + variables(dark=False)).replace("DARK", _DARK + variables(dark=True))

// SPDX-License-Identifier: Apache-2.0
#include <cstddef>

#include "examples/sequence/report_palette.hpp"
#include "examples/sequence/report_sections.hpp"

namespace seq::detail {
namespace {

/// Variables of one mode: the panel and the stages.
std::string colours(char const* page_colour::*mode) {
  std::string out = std::string("  --panel: ") + panel_colour.*mode + ";";
  for (std::size_t s = 0; s < stage_palette.size(); ++s) {
    out +=
        (s % 8 == 0 ? "\n  --s" : " --s") + std::to_string(s) + ": " + stage_palette[s].*mode + ";";
  }
  return out;
}

/// A class for each stage's colour.
std::string stage_classes() {
  std::string out;
  for (std::size_t s = 0; s < stage_palette.size(); ++s) {
    std::string const name = "s" + std::to_string(s);
    out += "." + name + " { fill: var(--" + name + "); }\n";
  }
  return out;
}

char const* const light_page = R"css(:root { color-scheme: light dark;
  --page: #f4f6f9; --ink: #18202c; --soft: #5b6676; --line: #dfe4eb;
  --grid: #e7ebf1;
  --accent: #2b62d9; --wash: rgba(43, 98, 217, .12); --truth: #b9c0cb; --good: #1f8f52;
  --fair: #c98a10;
  --bad: #cc3b30; --level: #39424f;
  --count0: #7d828c; --count1: #b97a00; --count2: #a463f2;
)css";

char const* const dark_page = R"css( }
@media screen and (prefers-color-scheme: dark) { :root {
  --page: #0f131a; --ink: #e6eaf1; --soft: #97a3b4; --line: #2a3240;
  --grid: #262e3a;
  --accent: #77a3ff; --wash: rgba(119, 163, 255, .16); --truth: #566070; --good: #4cc583;
  --fair: #e5b04a;
  --bad: #f0766b; --level: #c5cedb; --count0: #9498a0; --count1: #efb118; --count2: #b582f5;
)css";

char const* const layout = R"css( } }
* { box-sizing: border-box; }
body { margin: 0; background: var(--page); color: var(--ink);
  font: 15px/1.5 system-ui, -apple-system, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif;
  -webkit-print-color-adjust: exact; print-color-adjust: exact; }
main { max-width: 1120px; margin: 0 auto; padding: 32px 20px 48px; }
header { margin-bottom: 22px; }
h1 { font-size: 26px; line-height: 1.25; margin: 0 0 6px; letter-spacing: -.01em;
  overflow-wrap: anywhere; }
h2 { font-size: 17px; margin: 0 0 2px; }
h3 { font-size: 12px; margin: 0 0 6px; color: var(--soft); text-transform: uppercase;
  letter-spacing: .06em; }
.lead { margin: 0; color: var(--soft); display: flex; flex-wrap: wrap; gap: 4px 8px; }
.lead span { background: var(--panel); border: 1px solid var(--line); border-radius: 999px;
  padding: 1px 11px; font-size: 13px; overflow-wrap: anywhere; }
.cards { display: grid; grid-template-columns: repeat(4, 1fr); gap: 12px; margin-bottom: 16px; }
.card, section { background: var(--panel); border: 1px solid var(--line); border-radius: 10px; }
.card { padding: 13px 16px 12px; }
.card .name { font-size: 12px; color: var(--soft); text-transform: uppercase;
  letter-spacing: .05em; }
.card .value { font-size: 27px; font-weight: 650; line-height: 1.3;
  font-variant-numeric: tabular-nums;
  white-space: nowrap; }
.card .unit { font-size: 14px; font-weight: 400; color: var(--soft); }
.card .note { font-size: 12.5px; color: var(--soft); line-height: 1.4; }
.card.good .value { color: var(--good); } .card.fair .value { color: var(--fair); }
.card.bad .value { color: var(--bad); }
section { padding: 18px 20px 16px; margin-bottom: 16px; }
.caption { margin: 0 0 10px; color: var(--soft); font-size: 13px; max-width: 125ch; }
.nothing { margin: 6px 0 4px; color: var(--soft); font-style: italic; }
.scroll { overflow-x: auto; }
.legend { display: flex; flex-wrap: wrap; gap: 4px 18px; margin: 0 0 8px; font-size: 13px; }
.key { display: inline-flex; align-items: center; gap: 7px; }
.swatch { width: 22px; height: 12px; flex: none; }
svg.chart { display: block; width: 100%; min-width: 620px; height: auto; }
svg text { font-family: inherit; }
.tick { font-size: 12px; fill: var(--soft); font-variant-numeric: tabular-nums; }
.strong { font-weight: 650; fill: var(--ink); }
.axis { font-size: 12.5px; fill: var(--soft); }
.mid { text-anchor: middle; } .end { text-anchor: end; }
.grid { stroke: var(--grid); fill: none; }
.estimate { stroke: var(--accent); stroke-width: 2; fill: none; stroke-linejoin: round; }
.loop { stroke: var(--good); stroke-width: 2.5; fill: none; stroke-linecap: round; }
.open-loop { stroke: var(--good); stroke-width: .6; fill: none; opacity: .6; }
.tracked { stroke: var(--bad); stroke-width: 1.5; fill: none; stroke-dasharray: 5 4; }
.truth { stroke: var(--truth); stroke-width: 5; fill: none; stroke-linejoin: round; }
.wash { fill: var(--wash); }
.level { stroke: var(--level); stroke-width: 1.2; stroke-dasharray: 5 4; fill: none; }
.outline { stroke: var(--ink); stroke-width: .9; fill: none; stroke-linejoin: round; }
.beyond { fill: var(--bad); }
.cloud { stroke: var(--soft); stroke-width: 2.2; stroke-linecap: round; opacity: .6; fill: none; }
.cloud-key { fill: var(--soft); }
svg.space { cursor: grab; touch-action: pan-y; overflow: hidden; }
.warnings { border-left: 4px solid var(--bad); }
.list { margin: 4px 0 0; padding-left: 20px; overflow-wrap: anywhere; }
circle.start { fill: var(--good); stroke: var(--panel); stroke-width: 1.5; }
circle.end { fill: var(--bad); stroke: var(--panel); stroke-width: 1.5; }
)css";

char const* const charts = R"css(.sum { fill: var(--ink); } .track { fill: var(--grid); }
.c0, .c1, .c2, .c3 { fill: none; stroke-width: 1.6; stroke-linejoin: round; }
.c0 { stroke: var(--count0); } .c1 { stroke: var(--count1); } .c2 { stroke: var(--count2); }
.c3 { stroke: var(--accent); stroke-width: 2; }
.band { stroke: none; opacity: .16; }
.c0.band { fill: var(--count0); } .c1.band { fill: var(--count1); }
.c2.band { fill: var(--count2); }
.c3.band { fill: var(--accent); }
.lost { fill: var(--bad); opacity: .22; }
.warned { fill: var(--bad); }
.key-tick { stroke: var(--ink); stroke-width: 1; fill: none; opacity: .7; }
table { border-collapse: collapse; width: 100%; font-size: 14px; }
.figures th { color: var(--soft); font-weight: 500; font-size: 12.5px; }
.figures th, .figures td { text-align: left; padding: 6px 10px;
  border-bottom: 1px solid var(--line);
  white-space: nowrap; }
.figures th:first-child, .figures td:first-child { padding-left: 0; }
.figures .number { text-align: right; font-variant-numeric: tabular-nums; }
.figures .share { padding-left: 28px; width: 235px; }
.figures .share span { display: inline-block; width: 58px; text-align: right;
  font-variant-numeric: tabular-nums; color: var(--soft); }
.figures .total td { font-weight: 650; border-bottom: 0; border-top: 2px solid var(--line); }
.chip { width: 10px; height: 10px; margin-right: 9px; }
.bar { width: 120px; height: 10px; }
.samples { display: grid; gap: 16px; margin-top: 18px; }
  .samples.pairs { grid-template-columns: 1fr 1fr; }
figure { margin: 0; }
svg.sample { display: block; width: 100%; height: auto; border-radius: 6px; background: #22262d; }
.shade { fill: #10141a; opacity: .28; }
figcaption { font-size: 13px; color: var(--soft); margin-top: 5px; }
figcaption b { color: var(--ink); margin-right: 6px; }
.depth-bar { width: 240px; height: 28px; margin-bottom: -8px; overflow: visible; }
.columns { display: grid; grid-template-columns: 1fr 1fr; gap: 8px 36px; margin-top: 8px; }
.plain th, .plain td { text-align: left; vertical-align: top; padding: 4px 12px 4px 0;
  font-size: 13.5px;
  border-bottom: 1px solid var(--line); overflow-wrap: anywhere; }
.plain th { font-weight: 400; color: var(--soft); width: 38%; }
.plain td { font-family: ui-monospace, SFMono-Regular, Menlo, Consolas, monospace;
  font-size: 12.5px; }
footer { color: var(--soft); font-size: 12.5px; }
@media screen and (max-width: 760px) { .cards, .columns { grid-template-columns: 1fr 1fr; }
  .columns, .samples.pairs { grid-template-columns: 1fr; } main { padding: 18px 10px; } }
@media print { body { background: none; font-size: 12px; } main { max-width: none; padding: 0; }
  .cards { gap: 6px; } .card { padding: 8px 10px; } .card .value { font-size: 19px; }
  .card .name, .card .note { font-size: 10px; } section { padding: 10px 12px; margin-bottom: 8px; }
  .figures th, .figures td { padding: 3px 6px; font-size: 12px; }
  .card, section, figure { break-inside: avoid; }
  svg.chart { min-width: 0; } .scroll { overflow: visible; } }
)css";

}  // namespace

std::string style_sheet() {
  return light_page + colours(&page_colour::light) + dark_page + colours(&page_colour::dark) +
         layout + stage_classes() + charts;
}

}  // namespace seq::detail

// SPDX-License-Identifier: Apache-2.0
/// @file Colours of the report's stages. Not API: included by the report's parts and tests only.
#pragma once

#include <array>

namespace seq::detail {

/// A colour as "#rrggbb" on the light and on the dark page.
struct page_colour {
  char const* light;
  char const* dark;
};

/// Background of charts.
constexpr page_colour panel_colour = {"#ffffff", "#181e27"};

/// One per stage, in their order. Any two differ by at least 20 in CIEDE2000, neighbours in the
/// stack by 40, and each has a contrast of at least 3 to the panel.
constexpr std::array<page_colour, 17> stage_palette = {{
    {"#bb1144", "#886666"},
    {"#0077dd", "#55bb00"},
    {"#229955", "#99eeff"},
    {"#554455", "#ffcccc"},
    {"#0099aa", "#557733"},
    {"#aa4400", "#7755cc"},
    {"#ff44bb", "#bbbb99"},
    {"#777766", "#3399ff"},
    {"#0033bb", "#ffaa66"},
    {"#ff5555", "#ff0088"},
    {"#554400", "#117777"},
    {"#9977ee", "#aa6600"},
    {"#aa7700", "#00ccaa"},
    {"#aa1199", "#ee88ff"},
    {"#005533", "#ffdd11"},
    {"#997788", "#9999aa"},
    {"#001111", "#ccff99"},
}};

}  // namespace seq::detail

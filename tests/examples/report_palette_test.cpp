// SPDX-License-Identifier: Apache-2.0
/// @file The colours of the report's stages can be told from each other and from the page.
#include "examples/sequence/report_palette.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <fstream>
#include <iterator>
#include <set>
#include <string>

#include "examples/sequence/report.hpp"
#include "tests/support/sequence.hpp"

namespace {

using seq::detail::page_colour;
using seq::detail::panel_colour;
using seq::detail::stage_palette;
using three = std::array<double, 3>;

constexpr double half_circle = 3.14159265358979323846;  // radians

/// Linear red, green and blue of "#rrggbb".
three linear(std::string const& colour) {
  EXPECT_EQ(colour.size(), 7U);
  three out{};
  for (std::size_t i = 0; i < 3; ++i) {
    double const v = std::stoi(colour.substr(1 + 2 * i, 2), nullptr, 16) / 255.0;
    out[i] = v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
  }
  return out;
}

double luminance(std::string const& colour) {
  three const c = linear(colour);
  return 0.2126 * c[0] + 0.7152 * c[1] + 0.0722 * c[2];
}

/// Of WCAG 2: 1 to 21.
double contrast(std::string const& a, std::string const& b) {
  auto const [low, high] = std::minmax({luminance(a), luminance(b)});
  return (high + 0.05) / (low + 0.05);
}

/// CIE L*a*b* for D65.
three lab(std::string const& colour) {
  three const c = linear(colour);
  auto const f = [](double t) {
    return t > 216.0 / 24389 ? std::cbrt(t) : (24389.0 / 27 * t + 16) / 116;
  };
  double const x = f((0.4124564 * c[0] + 0.3575761 * c[1] + 0.1804375 * c[2]) / 0.95047);
  double const y = f(0.2126729 * c[0] + 0.7151522 * c[1] + 0.0721750 * c[2]);
  double const z = f((0.0193339 * c[0] + 0.1191920 * c[1] + 0.9503041 * c[2]) / 1.08883);
  return {116 * y - 16, 500 * (x - y), 200 * (y - z)};
}

/// CIEDE2000. Source: G. Sharma, W. Wu, E. N. Dalal, The CIEDE2000 color-difference formula, 2005.
double difference(three const& p, three const& q) {
  auto const degrees = [](double y, double x) {
    double const d = std::atan2(y, x) * 180 / half_circle;
    return d < 0 ? d + 360 : d;
  };
  auto const cosine = [](double d) { return std::cos(d * half_circle / 180); };
  auto const seventh = [](double c) {
    return std::sqrt(std::pow(c, 7) / (std::pow(c, 7) + std::pow(25.0, 7)));
  };
  double const g = 1.5 - 0.5 * seventh((std::hypot(p[1], p[2]) + std::hypot(q[1], q[2])) / 2);
  double const c1 = std::hypot(g * p[1], p[2]), c2 = std::hypot(g * q[1], q[2]);
  double const h1 = degrees(p[2], g * p[1]), h2 = degrees(q[2], g * q[1]);
  double turn = c1 * c2 == 0 ? 0 : h2 - h1;
  if (turn > 180) { turn -= 360; }
  if (turn < -180) { turn += 360; }
  double h = c1 * c2 == 0 ? h1 + h2 : (h1 + h2) / 2;
  if (c1 * c2 != 0 && std::abs(h1 - h2) > 180) { h += h1 + h2 < 360 ? 180 : -180; }
  double const l = (p[0] + q[0]) / 2, c = (c1 + c2) / 2;
  double const t = 1 - 0.17 * cosine(h - 30) + 0.24 * cosine(2 * h) + 0.32 * cosine(3 * h + 6) -
                   0.2 * cosine(4 * h - 63);
  double const from_50 = (l - 50) * (l - 50);
  double const dl = (q[0] - p[0]) / (1 + 0.015 * from_50 / std::sqrt(20 + from_50));
  double const dc = (c2 - c1) / (1 + 0.045 * c);
  double const dh =
      2 * std::sqrt(c1 * c2) * std::sin(turn / 2 * half_circle / 180) / (1 + 0.015 * c * t);
  double const bend = std::exp(-((h - 275) / 25) * ((h - 275) / 25));
  double const rotation = -2 * seventh(c) * std::sin(60 * bend * half_circle / 180);
  return std::sqrt(dl * dl + dc * dc + dh * dh + rotation * dc * dh);
}

TEST(report_palette, difference_is_that_of_the_paper) {
  // rows 1, 7, 17 and 25 of its table of test data
  EXPECT_NEAR(difference({50, 2.6772, -79.7751}, {50, 0, -82.7485}), 2.0425, 5e-5);
  EXPECT_NEAR(difference({50, 0, 0}, {50, -1, 2}), 2.3669, 5e-5);
  EXPECT_NEAR(difference({50, 2.5, 0}, {73, 25, -18}), 27.1492, 5e-5);
  EXPECT_NEAR(difference({60.2574, -34.0099, 36.2677}, {60.4626, -34.1751, 39.4387}), 1.2644, 5e-5);
}

TEST(report_palette, colours_differ_on_either_page) {
  for (auto const mode : {&page_colour::light, &page_colour::dark}) {
    for (std::size_t i = 0; i < stage_palette.size(); ++i) {
      std::string const a = stage_palette[i].*mode;
      EXPECT_GE(contrast(a, panel_colour.*mode), 3) << a;
      for (std::size_t j = 0; j < i; ++j) {
        std::string const b = stage_palette[j].*mode;
        EXPECT_GE(difference(lab(a), lab(b)), i == j + 1 ? 40 : 20) << a << ' ' << b;
      }
    }
  }
}

std::string page_with(std::size_t stages) {
  seq::run_report r;
  for (std::size_t s = 0; s < stages; ++s) { r.stages.push_back("stage " + std::to_string(s)); }
  r.stages.push_back("total");
  seq::frame_record frame;
  frame.stage_ms.assign(r.stages.size(), 1.0);
  r.records.push_back(frame);
  seq_test::temp_folder const folder;
  seq::write_html(folder.path("report.html"), r);
  std::ifstream file(folder.path("report.html"));
  return {std::istreambuf_iterator<char>(file), {}};
}

TEST(report_palette, every_stage_has_its_own_colour) {
  std::string const page = page_with(stage_palette.size());
  EXPECT_NE(page.find(std::string("--panel: ") + panel_colour.light), std::string::npos);
  EXPECT_NE(page.find(std::string("--panel: ") + panel_colour.dark), std::string::npos);
  std::set<std::string> styles;
  std::string const table = page.substr(page.find("Time per stage"));
  for (std::size_t s = 0; s < stage_palette.size(); ++s) {
    std::size_t const name = table.find(">stage " + std::to_string(s) + "<");
    std::size_t const chip = table.rfind("<rect class=\"", name);
    ASSERT_NE(chip, std::string::npos);
    std::size_t const begin = chip + 13;
    std::string const style = table.substr(begin, table.find('"', begin) - begin);
    styles.insert(style);
    EXPECT_NE(page.find("." + style + " { fill: var(--" + style + "); }"), std::string::npos);
    for (auto const mode : {&page_colour::light, &page_colour::dark}) {
      EXPECT_NE(page.find("--" + style + ": " + stage_palette[s].*mode + ";"), std::string::npos);
    }
  }
  EXPECT_EQ(styles.size(), stage_palette.size());
}

TEST(report_palette, more_stages_than_colours_are_refused) {
  try {
    page_with(stage_palette.size() + 1);
    ADD_FAILURE() << "no exception";
  } catch (seq::error const& e) {
    EXPECT_NE(std::string(e.what()).find("18 stages"), std::string::npos) << e.what();
    EXPECT_NE(std::string(e.what()).find("17"), std::string::npos) << e.what();
  }
}

}  // namespace

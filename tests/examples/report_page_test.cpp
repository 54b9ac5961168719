// SPDX-License-Identifier: Apache-2.0
// report.html.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <limits>
#include <string>

#include "examples/sequence/report.hpp"
#include "tests/support/report_markup.hpp"
#include "tests/support/report_runs.hpp"

namespace report_test {

TEST_F(report, the_markup_check_finds_faults) {
  auto const with = [](std::string const& body) { return "<style></style><p>" + body + "</p>"; };
  EXPECT_EQ(markup_fault(with("<rect x=\"1\" y=\"-2.5\"/>")), "");
  EXPECT_EQ(markup_fault(with("<script>var a=[1,{b:\")\"}];</script>")), "");
  for (char const* bad :
       {"<b>", "</b>", "<rect x=\"nan\"/>", "<rect x=\"-inf\"/>", "<path d=\"M1 nan\"/>",
        "<path d=\"\"/>", "<script src=\"a.js\"></script>", "<a href=\"http://a.b\"></a>",
        "<a & b=c></a>", "< <b></b>", "<script>var a=[1,2;</script>", "<script>fetch(1)</script>",
        "<script>a</script><script>b</script>", "<script>var a=NaN;</script>",
        "<script defer>a</script>"}) {
    EXPECT_NE(markup_fault(with(bad)), "") << bad;
  }
}

TEST_F(report, html_of_an_empty_report) {
  std::string const text = html({});
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_NE(text.find("n/a"), std::string::npos);
  EXPECT_NE(text.find("No frame was processed."), std::string::npos);
  EXPECT_EQ(count(text, "<image"), 0);
}

TEST_F(report, html_of_a_filled_report) {
  seq::run_report r = filled(120, true);
  add_sample(r, 64, 48, 50);
  add_sample(r, 64, 48, 0);
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_EQ(count(text, "<svg"), count(text, "</svg>"));
  EXPECT_EQ(count(text, "http"), 0);
  EXPECT_EQ(count(text, "<script"), 1);
  EXPECT_EQ(count(text, "<image"), 2);
  EXPECT_EQ(count(text, "data:image/jpeg;base64,/9j/"), 2);  // FF D8 FF: a JPEG
  for (char const* words :
       {"Trajectory", "ground truth", "Position error over time", "Time per frame",
        "Time per stage", "Keypoints and inliers", "Keypoints and tracks", "Options"}) {
    EXPECT_NE(text.find(words), std::string::npos) << words;
  }
  EXPECT_NE(text.find("The axis is cut"), std::string::npos);  // frame 3 took 400 ms
  EXPECT_GE(count(text, "<circle"), 50);
}

TEST_F(report, html_without_truth_has_no_error_chart) {
  std::string const text = html(filled(40, false));
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_EQ(text.find("Position error over time"), std::string::npos);
  EXPECT_NE(text.find("no ground truth"), std::string::npos);
}

TEST_F(report, html_of_odd_reports) {
  seq::run_report none_tracked = filled(30, true);
  none_tracked.estimate.clear();
  none_tracked.tracked = 0;
  none_tracked.error = {};
  for (auto& f : none_tracked.records) { f.tracked = false; }
  EXPECT_EQ(markup_fault(html(none_tracked)), "");

  seq::run_report standing = filled(30, true);
  for (auto* poses : {&standing.estimate, &standing.truth}) {
    for (auto& p : *poses) { p.T_world_camera.translation().setZero(); }
  }
  EXPECT_EQ(markup_fault(html(standing)), "");

  seq::run_report one = filled(1, true);
  add_sample(one, 16, 16, 3);
  EXPECT_EQ(markup_fault(html(one)), "");

  seq::run_report untimed = filled(10, false);
  for (auto& f : untimed.records) { f.stage_ms.clear(); }
  EXPECT_EQ(markup_fault(html(untimed)), "");

  seq::run_report stages_only;
  stages_only.stages = {"total"};
  EXPECT_EQ(markup_fault(html(stages_only)), "");

  for (double const far : {1e12, 1e18, 1e200}) {  // a run that diverged
    seq::run_report diverged = filled(30, true);
    for (auto& p : diverged.estimate) { p.T_world_camera.translation().x() += far; }
    EXPECT_EQ(markup_fault(html(diverged)), "") << far;
    diverged.truth.clear();
    EXPECT_EQ(markup_fault(html(diverged)), "") << far;
  }

  seq::run_report apart = filled(10, true);  // truth of another day
  for (auto& p : apart.truth) { p.time_ns -= 86'400'000'000'000LL; }
  apart.error = {};
  EXPECT_EQ(markup_fault(html(apart)), "");
}

TEST_F(report, html_never_prints_what_is_not_finite) {
  seq::run_report r = filled(50, true);
  add_sample(r, 32, 32, 20);
  r.error.path_m = nan_value;
  r.error.ate_rmse_m = inf_value;
  r.error.truth_path_m = nan_value;
  r.estimate[3].T_world_camera.translation().y() = nan_value;
  r.truth[7].T_world_camera.translation().x() = inf_value;
  r.records[4].stage_ms[2] = nan_value;
  r.records[5].stage_ms[0] = inf_value;
  auto& points = r.samples[0].keypoints;
  points[0].x = std::numeric_limits<float>::quiet_NaN();
  points[1].depth = std::numeric_limits<float>::infinity();
  points[2].size = std::numeric_limits<float>::quiet_NaN();
  points[4].from_x = std::numeric_limits<float>::infinity();
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  std::string page = text;  // without the pictures' letters
  for (std::size_t at = 0; (at = page.find("base64,", at)) != std::string::npos; at += 7) {
    page.erase(at + 7, page.find('"', at) - at - 7);
  }
  EXPECT_FALSE(has_word(page, "nan"));
  EXPECT_FALSE(has_word(page, "inf"));
}

TEST_F(report, html_escapes_text) {
  seq::run_report r = filled(5, false);
  r.title = "<b>a & \"b\"</b>";
  r.options["<x>"] = "1 < 2 && 'y'";
  r.stages[0] = "f<a>st";
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_EQ(text.find("<b>a"), std::string::npos);
  EXPECT_NE(text.find("&lt;b&gt;a &amp; &quot;b&quot;&lt;/b&gt;"), std::string::npos);
  EXPECT_NE(text.find("1 &lt; 2 &amp;&amp; &#39;y&#39;"), std::string::npos);
  EXPECT_NE(text.find("f&lt;a&gt;st"), std::string::npos);
}

// Everything at its largest: 5000 frames, 16 stages, pictures of pure noise, the worst there are.
TEST_F(report, html_has_at_most_a_megabyte) {
  seq::run_report r = filled(5000, true);
  r.stages.clear();
  for (int s = 0; s < 15; ++s) { r.stages.push_back("stage " + std::to_string(s)); }
  r.stages.emplace_back("total");
  for (std::size_t i = 0; i < r.records.size(); ++i) {
    r.records[i].stage_ms.assign(16, 0.1 + 0.01 * static_cast<double>(i % 7));
  }
  add_cloud(r, 100'000);
  std::string const charts = html(r);
  EXPECT_EQ(markup_fault(charts), "");
  EXPECT_LT(charts.size(), 600'000U);
  for (int i = 0; i < 8; ++i) { add_sample(r, 1392, 512, 2000); }
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_LE(text.size(), 1'000'000U);
  EXPECT_EQ(count(text, "<image"), 8);
  for (auto& sample : r.samples) {
    for (int i = 0; i < 6; ++i) {  // 128,000 keypoints each
      sample.keypoints.insert(sample.keypoints.end(), sample.keypoints.begin(),
                              sample.keypoints.end());
    }
  }
  std::string const many = html(r);
  EXPECT_LE(many.size(), 1'000'000U);
  EXPECT_EQ(count(many, "<image"), 8);
  EXPECT_GE(count(many, "<circle"), 5000);
}

TEST_F(report, html_draws_path_and_map_in_space) {
  seq::run_report r = filled(200, true);
  add_cloud(r, 500);
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_NE(text.find("Path and map in space"), std::string::npos);
  std::string const script = script_of(text);
  for (char const* name : {"cloud=[[", "truth=[[", "estimate=[[", "ends=[["}) {
    EXPECT_NE(script.find(name), std::string::npos) << name;
  }
  // each point three numbers; a few that lie apart from the rest may be left out
  std::size_t const begin = script.find("cloud=[[") + 8;
  std::string const cloud = script.substr(begin, script.find(']', begin) - begin);
  int const numbers = count(cloud, ",") + 1;
  EXPECT_EQ(numbers % 3, 0);
  EXPECT_GE(numbers / 3, 450);
  EXPECT_LE(numbers / 3, 500);
  // what is drawn without the script is as much
  std::size_t const drawing = text.find("<path class=\"cloud\" d=\"");
  ASSERT_NE(drawing, std::string::npos);
  std::string const dots = text.substr(drawing, text.find("/>", drawing) - drawing);
  EXPECT_EQ(count(dots, "M"), numbers / 3);

  seq::run_report nothing = filled(20, false);
  nothing.estimate.clear();
  EXPECT_EQ(html(nothing).find("<script"), std::string::npos);
}

// A square of 2 m seen at the same time from all four corners: the alignment to the ground truth
// moves the map as it moves the path.
TEST_F(report, html_moves_the_map_with_the_path) {
  seq::run_report r;
  for (int i = 0; i < 4; ++i) {
    seq::stamped_pose p;
    p.time_ns = i * std::int64_t{50'000'000};
    p.T_world_camera.translation() = Eigen::Vector3d(i % 2 * 2, 0, i / 2 * 2);
    r.estimate.push_back(p);
    r.cloud.push_back(p.T_world_camera.translation().cast<float>());
  }
  auto const numbers = [](std::string const& script, std::string const& name) {
    std::size_t const at = script.find(name + "=[[") + name.size() + 3;
    return script.substr(at, script.find(']', at) - at);
  };
  std::string const alone = script_of(html(r));
  EXPECT_EQ(numbers(alone, "cloud"), numbers(alone, "estimate"));
  r.truth = r.estimate;
  for (auto& p : r.truth) { p.T_world_camera.translation() += Eigen::Vector3d(100, 20, -7); }
  r.error.T_truth_estimate.translation() = Eigen::Vector3d(100, 20, -7);
  std::string const moved = script_of(html(r));
  EXPECT_EQ(numbers(moved, "cloud"), numbers(moved, "estimate"));
  EXPECT_EQ(numbers(moved, "cloud"), numbers(moved, "truth"));
  EXPECT_EQ(numbers(moved, "cloud"), numbers(alone, "cloud"));
  // corners of the drawn box: right, forward, up
  EXPECT_EQ(numbers(alone, "cloud"), "-1000,-1000,0,1000,-1000,0,-1000,1000,0,1000,1000,0");
}

TEST_F(report, html_has_the_rotation_error) {
  std::string const text = html(filled(60, true));
  EXPECT_NE(text.find("Rotation error over time"), std::string::npos);
  EXPECT_NE(text.find("rotation 1.50\xc2\xb0"), std::string::npos);
  EXPECT_NE(text.find("rotation 0.750\xc2\xb0"), std::string::npos);
  seq::run_report positions = filled(60, true);
  positions.error.ate_rotation_rmse_deg.reset();
  positions.error.rpe_rotation_rmse_deg.reset();
  EXPECT_EQ(html(positions).find("Rotation error over time"), std::string::npos);
}

TEST_F(report, html_leaves_out_broken_samples) {
  seq::run_report r = filled(5, false);
  r.samples.resize(2);
  r.samples[1].picture.width = 10;
  r.samples[1].picture.height = 10;  // and no pixels
  std::string const text = html(r);
  EXPECT_EQ(markup_fault(text), "");
  EXPECT_EQ(count(text, "<image"), 0);
}

}  // namespace report_test

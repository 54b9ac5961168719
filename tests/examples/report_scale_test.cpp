// SPDX-License-Identifier: Apache-2.0
// The scale of a path: whether it is known, from when on, and whether it is the ground truth's.
#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>
#include <string>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/report.hpp"
#include "examples/sequence/warnings.hpp"
#include "tests/support/sequence.hpp"

namespace report_scale_test {

using seq_test::contains;

constexpr std::int64_t period = 50'000'000;

/// Half a circle of 2 m. @param noise of each coordinate, metres
seq::trajectory arc(int poses, double radius, double noise = 0, unsigned seed = 1) {
  std::mt19937 bits(seed);
  std::normal_distribution<double> gauss;
  seq::trajectory path;
  for (int i = 0; i < poses; ++i) {
    double const angle = 3.14 * i / poses;
    seq::stamped_pose pose;
    pose.time_ns = i * period;
    pose.T_world_camera.translation() =
        Eigen::Vector3d(radius * std::cos(angle), radius * std::sin(angle), 0);
    for (int k = 0; k < 3; ++k) { pose.T_world_camera.translation()[k] += noise * gauss(bits); }
    path.push_back(pose);
  }
  return path;
}

/// All frames are tracked. @param without_scale of them before the scale was known
seq::run_report run_of(seq::trajectory const& estimate, seq::trajectory const& truth,
                       int without_scale = 0) {
  seq::run_report r;
  r.stages = {"total"};
  r.frames = r.tracked = static_cast<int>(estimate.size());
  r.maps = 1;
  for (int i = 0; i < r.frames; ++i) {
    seq::frame_record record;
    record.index = i;
    record.time_ns = i * period;
    record.tracked = true;
    record.metric = i >= without_scale;
    record.keypoints = 1000;
    record.stereo_matches = 500;
    record.stage_ms = {1.0};
    r.records.push_back(record);
  }
  r.estimate = estimate;
  r.truth = truth;
  r.error = seq::evaluate(estimate, truth, true);
  r.fit = seq::fit_scale(estimate, truth);
  if (r.fit && !r.fit->same_shape()) { r.fit.reset(); }  // as track_sequence does
  return r;
}

std::string printed(seq::run_report const& r) {
  std::ostringstream out;
  seq::print_summary(out, r);
  return out.str();
}

/// What a writer writes to a file.
std::string written(void (*write)(std::string const&, seq::run_report const&),
                    seq::run_report const& r) {
  seq_test::temp_folder const folder;
  write(folder.path("file"), r);
  std::ifstream in(folder.path("file"), std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

TEST(ReportScale, APathInAnotherUnitIsAWarning) {
  auto const truth = arc(100, 2);
  for (double const factor : {10.0, 0.1, 1.06, 0.94}) {
    seq::run_report const r = run_of(arc(100, 2 * factor, 0.002 * factor), truth);
    ASSERT_TRUE(r.fit);
    EXPECT_NEAR(r.fit->scale * factor, 1, 0.01);
    auto const all = seq::warnings_of(r);
    ASSERT_EQ(all.size(), 1U) << factor;
    EXPECT_TRUE(contains(all[0], "the baseline another one")) << all[0];
    auto const j = nlohmann::json::parse(written(seq::write_summary_json, r));
    EXPECT_NEAR(j["scale_to_truth"].get<double>() * factor, 1, 0.01);
    EXPECT_TRUE(j["scale"].is_null()) << "it is not applied";
    EXPECT_TRUE(contains(printed(r), "scale to truth    x "));
  }
  seq::run_report depth = run_of(arc(100, 0.4), truth);
  depth.depth_images = true;
  EXPECT_TRUE(contains(seq::warnings_of(depth).at(0), "--depth-unit"));
  depth.one_camera = true;
  EXPECT_TRUE(contains(seq::warnings_of(depth).at(0), "IMU"));
}

TEST(ReportScale, ErrorsThatAreNotThoseOfAUnitAreNoWarning) {
  auto const truth = arc(100, 2);
  EXPECT_TRUE(seq::warnings_of(run_of(arc(100, 2 * 1.04, 0.002), truth)).empty());
  // A path that went wrong has no scale that would fit it.
  EXPECT_TRUE(seq::warnings_of(run_of(arc(100, 0.5, 0.3), truth)).empty());
  // Neither has a camera that stands still: what is left is noise, of another size in each.
  for (unsigned seed = 1; seed <= 50; ++seed) {
    for (int const poses : {8, 16, 100}) {
      seq::run_report const still =
          run_of(arc(poses, 0, 1e-3, seed), arc(poses, 0, 1e-4, seed + 1000));
      EXPECT_TRUE(seq::warnings_of(still).empty()) << seed << " " << poses;
      EXPECT_FALSE(contains(printed(still), "scale to truth")) << seed << " " << poses;
    }
  }
  seq::run_report const none = run_of(arc(100, 2), {});
  EXPECT_FALSE(none.fit);
  EXPECT_FALSE(contains(printed(none), "scale to truth"));
}

TEST(ReportScale, TheFitsErrorIsThatOfTheScaledPath) {
  auto const truth = arc(100, 2);
  auto const path = arc(100, 0.7, 0.01);
  auto const fit = seq::fit_scale(path, truth);
  ASSERT_TRUE(fit);
  EXPECT_EQ(fit->scale, *seq::scale_to(path, truth));
  EXPECT_EQ(fit->pairs, 100);
  auto const after = seq::evaluate(seq::scaled(path, fit->scale), truth, false);
  EXPECT_NEAR(fit->error_m, *after.ate_rmse_m, 1e-6);
}

TEST(ReportScale, FramesBeforeTheScaleWasKnownAreCounted) {
  seq::run_report r = run_of(arc(40, 2), arc(40, 2), 12);
  EXPECT_EQ(nlohmann::json::parse(written(seq::write_summary_json, r))["without_scale"], 12);
  EXPECT_TRUE(contains(printed(r), "without scale     12 of the tracked")) << printed(r);
  EXPECT_TRUE(contains(written(seq::write_html, r), "12 before the scale was known"));
  r = run_of(arc(40, 2), arc(40, 2));
  EXPECT_EQ(nlohmann::json::parse(written(seq::write_summary_json, r))["without_scale"], 0);
  EXPECT_FALSE(contains(printed(r), "without scale"));
  r = run_of(arc(40, 2), {}, 40);  // never known: all are in the path
  r.metric = false;
  EXPECT_FALSE(contains(printed(r), "without scale"));
}

TEST(ReportScale, LengthsOfAnUnknownScaleAreNoMetres) {
  seq::run_report r = run_of(arc(40, 2), {});
  std::string const card = "<div class=\"name\">Path</div><div class=\"value\">";
  auto const value = [&] {
    std::string const html = written(seq::write_html, r);
    std::size_t const at = html.find(card);
    EXPECT_NE(at, std::string::npos);
    return html.substr(at + card.size(), html.find("</div>", at + card.size()) - at - card.size());
  };
  EXPECT_TRUE(contains(value(), " m</span>")) << value();
  r.metric = false;
  r.one_camera = true;
  EXPECT_FALSE(contains(value(), " m")) << value();
}

TEST(ReportScale, TheShareOfTrackedFramesIsOneNumber) {
  seq::run_report r = run_of(arc(60, 2), {});
  r.tracked = 49;  // 81.67 %
  EXPECT_TRUE(contains(printed(r), "49 (81.6 %)"));
  EXPECT_TRUE(contains(written(seq::write_html, r), ">81.6<"));
}

}  // namespace report_scale_test

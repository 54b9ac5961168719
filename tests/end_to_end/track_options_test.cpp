// SPDX-License-Identifier: Apache-2.0
/// @file What track_sequence does beside tracking: reading ahead, ending early, warnings, frames
/// and formats of poses. All on the host executor.
#include <gtest/gtest.h>
#include <signal.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/reader.hpp"
#include "include/ft/version.hpp"
#include "tests/end_to_end/process.hpp"
#include "tests/end_to_end/track_support.hpp"
#include "tests/support/ply_file.hpp"
#include "tests/support/sequence.hpp"

namespace {

using namespace app_test;

strings warnings_of(results const& r) { return r.summary.at("warnings").get<strings>(); }

/// Some warning has all of the words.
bool warned(results const& r, strings const& words) {
  strings const all = warnings_of(r);
  return std::any_of(all.begin(), all.end(), [&](std::string const& warning) {
    return std::all_of(words.begin(), words.end(),
                       [&](std::string const& word) { return contains(warning, word); });
  });
}

/// Every warning is on the terminal, in the summary and in the report.
void expect_warnings_everywhere(outcome const& o, results const& r, std::string const& out) {
  std::string const html = read_file(out + "/report.html");
  for (std::string const& warning : warnings_of(r)) {
    EXPECT_TRUE(contains(o.out, "warning: " + warning)) << warning;
    EXPECT_TRUE(contains(html, warning)) << warning;
  }
}

/// The same pairs again and again: `frames` lines in the lists, 50 ms apart.
void repeat_pairs(spoilt_sequence const& s, int frames) {
  for (char const* camera : {"cam0", "cam1"}) {
    std::ofstream list(s.path(camera + std::string("/data.csv")));
    for (int i = 0; i < frames; ++i) {
      std::string const file = fs::path(s.image(0, i % s.size())).filename().string();
      list << 1'000'000'000 + i * std::int64_t{50'000'000} << "," << file << "\n";
    }
  }
}

// ---- reading ahead

TEST(ReadAheadRuns, TheQueueChangesNothing) {
  temp_folder const folder;
  std::string const sequence =
      generated(many, {"--rig", "fisheye", "--width", "320", "--height", "320"});
  std::string first;
  for (char const* ahead : {"0", "1", "16", "1000"}) {
    ASSERT_TRUE(succeeded(track(sequence, folder.path("out"),
                                {"--rig", "rectified", "--frames", "12", "--read-ahead", ahead})));
    std::string const bytes = read_file(folder.path("out/trajectory.txt"));
    if (first.empty()) { first = bytes; }
    EXPECT_EQ(bytes, first) << ahead;
  }
  EXPECT_EQ(lines_of(first).size(), 13u);
}

// ---- ending early

TEST(Stopped, AtAnImageThatCannotBeRead) {
  constexpr int broken = 4;
  for (char const* ahead : {"0", "8"}) {
    spoilt_sequence const s(few);
    fs::resize_file(s.image(1, broken), fs::file_size(s.image(1, broken)) / 2);
    outcome const o = track(s.path(), s.out(), {"--read-ahead", ahead});
    EXPECT_TRUE(stopped_at(o, broken, s.image(1, broken)));
    results const r = read_results(s.out(), broken);  // all files, of the frames before it
    EXPECT_EQ(r.number("tracked"), broken);
    EXPECT_EQ(r.number("stopped_at"), broken);
    EXPECT_TRUE(warned(r, {"stopped at frame 4", s.image(1, broken)}));
    expect_warnings_everywhere(o, r, s.out());
  }
}

// The same poses as in a run that ends there by itself.
TEST(Stopped, WhatWasTrackedIsThatOfAShorterRun) {
  spoilt_sequence const s(few);
  std::ofstream(s.image(0, 3)) << "this is no image";
  EXPECT_TRUE(stopped_at(track(s.path(), s.out()), 3, s.image(0, 3)));
  temp_folder const folder;
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"), {"--frames", "3"})));
  EXPECT_EQ(read_file(s.out() + "/trajectory.txt"), read_file(folder.path("out/trajectory.txt")));
  EXPECT_TRUE(json::parse(read_file(folder.path("out/summary.json"))).at("stopped_at").is_null());
}

void expect_stop_by(int signal, std::string const& name) {
  spoilt_sequence const s(few);
  constexpr int endless = 2000;
  repeat_pairs(s, endless);
  outcome const o =
      track(s.path(), s.out(), {"--threads", "0"}, [&](pid_t process, std::string const& out) {
        if (!contains(out, "ETA")) { return false; }  // the first line of its progress
        ::kill(process, signal);
        return true;
      });
  auto const summary = json::parse(read_file(s.out() + "/summary.json"));
  int const frame = summary.at("stopped_at").get<int>();
  EXPECT_GE(frame, endless / 10);
  EXPECT_LT(frame, endless);
  EXPECT_TRUE(stopped_at(o, frame, name));
  results const r = read_results(s.out(), frame);
  EXPECT_EQ(r.number("frames"), frame);
  EXPECT_TRUE(warned(r, {"stopped at frame " + std::to_string(frame), name}));
}

TEST(Stopped, ByCtrlC) { expect_stop_by(SIGINT, "SIGINT"); }
TEST(Stopped, BySigterm) { expect_stop_by(SIGTERM, "SIGTERM"); }

// ---- warnings

TEST(Warnings, NoneForAGoodRun) {
  temp_folder const folder;
  outcome const o = track(generated(few), folder.path("out"));
  ASSERT_TRUE(succeeded(o));
  EXPECT_EQ(warnings_of(read_results(folder.path("out"), few)), strings{});
  EXPECT_FALSE(contains(o.out, "warning"));
}

TEST(Warnings, CamerasExchanged) {
  spoilt_sequence const s(few);
  fs::rename(s.path("cam0/data"), s.path("spare"));
  fs::rename(s.path("cam1/data"), s.path("cam0/data"));
  fs::rename(s.path("spare"), s.path("cam1/data"));
  outcome const o = track(s.path(), s.out());
  results const r = read_results(s.out(), few);
  EXPECT_TRUE(warned(r, {"stereo match", "left and right may be exchanged"}));
  EXPECT_TRUE(warned(r, {"stereo_inconsistent in ", "first in frame 0"}));
  EXPECT_GT(r.summary.at("reasons").at("stereo_inconsistent"), 0);
  expect_warnings_everywhere(o, r, s.out());
}

TEST(Warnings, UnpairedImages) {
  spoilt_sequence const s(few);
  fs::remove(s.image(1, 2));
  fs::remove(s.image(1, 3));
  fs::remove(s.image(0, 4));
  outcome const o = track(s.path(), s.out());
  ASSERT_TRUE(succeeded(o));
  results const r = read_results(s.out(), few - 3);
  EXPECT_TRUE(warned(r, {"2 of the left camera", "1 of the right"}));
  expect_warnings_everywhere(o, r, s.out());
}

// 1.35 s of black pictures: lost for as long, then found in the same map.
TEST(Warnings, LostForLong) {
  constexpr int frames = 60;
  spoilt_sequence const s(frames, {"--width", "376", "--height", "240"});
  for (int i = 22; i < 49; ++i) { s.set_pair(i, plain(0), plain(0)); }
  outcome const o = track(s.path(), s.out());
  results const r = read_results(s.out(), frames);
  EXPECT_TRUE(warned(r, {"lost for", "from frame 22 on"}));
  EXPECT_TRUE(warned(r, {"dark in 27 of 60 frames, first in frame 22: image 0 is nearly black"}));
  expect_warnings_everywhere(o, r, s.out());
}

// ---- frames and formats of poses

TEST(Poses, OfTheBodyAgreeWithItsGroundTruth) {
  temp_folder const folder;
  std::string const out = folder.path("out");
  ASSERT_TRUE(succeeded(track(generated(many), out, {"--frame", "body"})));
  results const body = read_results(out, many);
  test::ply_file const body_map(read_file(out + "/map.ply"));
  seq::trajectory const truth = seq::read_tum(out + "/groundtruth.txt");
  ASSERT_EQ(truth.size(), static_cast<std::size_t>(many));

  // the file's own rows are the body's
  std::string const row = "mav0/state_groundtruth_estimate0/data.csv";
  bool found = false;
  for (std::string const& line : lines_of(read_file(generated(many) + "/" + row))) {
    if (line.rfind(std::to_string(truth.front().time_ns) + ",", 0) != 0) { continue; }
    strings const fields = split(line, ',');
    for (int axis = 0; axis < 3; ++axis) {
      EXPECT_NEAR(truth.front().T_world_camera.translation()(axis),
                  std::stod(fields.at(static_cast<std::size_t>(axis) + 1)), 2e-6);
    }
    found = true;
  }
  EXPECT_TRUE(found);
  EXPECT_LT(largest_drift(body.path, truth), 0.1);

  ASSERT_TRUE(succeeded(track(generated(many), out)));
  results const camera = read_results(out, many);
  auto const sequence = seq::sequence::open(generated(many));
  Eigen::Isometry3d const T = sequence.rig().T_body_left;
  ASSERT_FALSE(T.matrix().isIdentity(1e-3));
  for (std::size_t i = 0; i < camera.path.size(); ++i) {
    Eigen::Matrix4d const expected = (T * camera.path[i].T_world_camera * T.inverse()).matrix();
    EXPECT_LT((body.path[i].T_world_camera.matrix() - expected).norm(), 1e-7) << i;
  }

  test::ply_file const map(read_file(out + "/map.ply"));
  ASSERT_EQ(map.vertices.size(), static_cast<std::size_t>(camera.number("map_points")));
  ASSERT_EQ(map.vertices.size(), body_map.vertices.size());
  EXPECT_GT(map.vertices.size(), 200u);
  Eigen::Isometry3f const to_body = T.cast<float>();
  for (std::size_t i = 0; i < map.vertices.size(); ++i) {
    Eigen::Map<Eigen::Vector3f const> const p(map.vertices[i].real.data());
    Eigen::Map<Eigen::Vector3f const> const q(body_map.vertices[i].real.data());
    EXPECT_LT((to_body * p - q).norm(), 1e-5f * (1 + p.norm())) << i;
  }
}

TEST(Poses, GroundTruthOfTheCameraLiesBeside) {
  temp_folder const folder;
  std::string const out = folder.path("out");
  ASSERT_TRUE(succeeded(track(generated(many), out)));
  results const r = read_results(out, many);
  seq::trajectory const truth = seq::read_tum(out + "/groundtruth.txt");
  auto const sequence = seq::sequence::open(generated(many));
  ASSERT_EQ(truth.size(), static_cast<std::size_t>(many));
  for (int i = 0; i < many; ++i) {
    auto const at = static_cast<std::size_t>(i);
    EXPECT_EQ(truth[at].time_ns, sequence.time_ns(i));
    auto const expected = seq::interpolate(sequence.ground_truth(), sequence.time_ns(i));
    ASSERT_TRUE(expected);
    EXPECT_LT((truth[at].T_world_camera.matrix() - expected->matrix()).norm(), 1e-7);
  }
  // the two files alone give the printed figures
  auto const error = seq::evaluate(r.path, truth, true);
  EXPECT_NEAR(*error.ate_rmse_m, r.summary.at("ate_rmse_m").get<double>(), 1e-7);
  EXPECT_NEAR(*error.rpe_rmse_m, r.summary.at("rpe_rmse_m").get<double>(), 1e-7);

  spoilt_sequence const without(few);
  fs::remove_all(without.path("state_groundtruth_estimate0"));
  ASSERT_TRUE(succeeded(track(without.path(), out)));
  EXPECT_FALSE(fs::exists(out + "/groundtruth.txt")) << "that of an older run";
}

TEST(Poses, CommandsOfEvoAreSaidEverywhere) {
  temp_folder const folder;
  outcome const o = track(generated(many), folder.path("out"));
  ASSERT_TRUE(succeeded(o));
  results const r = read_results(folder.path("out"), many);
  std::string const html = read_file(folder.path("out/report.html"));
  for (auto const& [figure, command] :
       {std::pair("ATE RMSE", "evo_ape tum groundtruth.txt trajectory.txt --align"),
        std::pair("RPE RMSE over 1 s",
                  "evo_rpe tum groundtruth.txt trajectory.txt --delta 20 --delta_unit f "
                  "--all_pairs")}) {
    EXPECT_EQ(r.summary.at("evo").at(figure).at("command"), command);
    EXPECT_EQ(r.summary.at("evo").at(figure).at("exact"), true);
    EXPECT_TRUE(contains(o.out, command));
    EXPECT_TRUE(contains(html, command));
  }
}

TEST(Poses, KittisTwelveNumbers) {
  temp_folder const folder;
  std::string const out = folder.path("out");
  spoilt_sequence const s(few);
  s.set_pair(0, plain(0), plain(0));
  s.set_pair(4, plain(0), plain(0));
  ASSERT_TRUE(succeeded(track(s.path(), out, {"--poses", "kitti"})));
  results const r = read_results(out, few);
  ASSERT_FALSE(r.tracked(0));
  ASSERT_FALSE(r.tracked(4));
  strings const lines = lines_of(read_file(out + "/poses.txt"));
  ASSERT_EQ(lines.size(), static_cast<std::size_t>(few));
  std::size_t pose = 0;
  Eigen::Matrix4d expected = Eigen::Matrix4d::Identity();
  for (std::size_t i = 0; i < lines.size(); ++i) {
    if (r.tracked(static_cast<int>(i))) { expected = r.path.at(pose++).T_world_camera.matrix(); }
    strings const numbers = split(lines[i], ' ');
    ASSERT_EQ(numbers.size(), 12u);
    for (std::size_t n = 0; n < 12; ++n) {
      EXPECT_NEAR(std::stod(numbers[n]), expected(static_cast<int>(n / 4), static_cast<int>(n % 4)),
                  1e-7);
    }
  }
  EXPECT_EQ(pose, r.path.size());
  ASSERT_TRUE(succeeded(track(s.path(), out)));
  EXPECT_FALSE(fs::exists(out + "/poses.txt")) << "that of an older run";
}

TEST(Poses, BodyOfACalibrationWithoutOne) {
  temp_folder const folder;
  write_kitti(generated(few), folder.path("kitti"), 0.05);
  EXPECT_TRUE(complained_of(track(folder.path("kitti"), folder.path("out"), {"--frame", "body"}),
                            "--frame body"));
}

// ---- options

TEST(Options, FolderAsPlainArgument) {
  temp_folder const folder;
  outcome const o = run_program(tracker, {generated(few), "--backend", "host", "--threads", "1",
                                          "--out", folder.path("out")});
  ASSERT_TRUE(succeeded(o));
  EXPECT_EQ(read_results(folder.path("out"), few).number("tracked"), few);
}

TEST(Options, Version) {
  outcome const o = run_program(tracker, {"--version"});
  ASSERT_TRUE(succeeded(o));
  EXPECT_EQ(o.out, "track_sequence " + std::to_string(FT_VERSION_MAJOR) + "." +
                       std::to_string(FT_VERSION_MINOR) + "." + std::to_string(FT_VERSION_PATCH) +
                       "\n");
}

TEST(Options, StageTimesOnlyWhereAskedFor) {
  temp_folder const folder;
  outcome const plain_run = track(generated(few), folder.path("out"));
  ASSERT_TRUE(succeeded(plain_run));
  EXPECT_FALSE(contains(plain_run.out, "descriptors"));
  results const r = read_results(folder.path("out"), few);
  EXPECT_EQ(r.summary.at("stages").size(), 1u);
  EXPECT_LT(plain_run.out.find("images to pose"), plain_run.out.find("total"));
  EXPECT_GT(r.summary.at("stages").at("total").at("mean_ms"), 0.0);
  outcome const timed = track(generated(few), folder.path("timed"), {"--timing"});
  ASSERT_TRUE(succeeded(timed));
  EXPECT_TRUE(contains(timed.out, "descriptors"));
  results const t = read_results(folder.path("timed"), few);
  EXPECT_GT(t.summary.at("stages").at("descriptors").at("mean_ms"), 0.0);
  // Nothing is prefetched there: the whole frame is the time from its images to its pose.
  EXPECT_EQ(t.summary.at("prefetch"), 0);
  double const total = t.summary.at("stages").at("total").at("mean_ms");
  double const to_pose = t.summary.at("images_to_pose").at("mean_ms");
  EXPECT_LE(to_pose, total);
  EXPECT_GT(to_pose, 0.9 * total);
  EXPECT_EQ(read_file(folder.path("out/trajectory.txt")),
            read_file(folder.path("timed/trajectory.txt")));
}

// The calls of a frame alone leave out its keypoints and stereo; the time to its pose has them, and
// that it waits for the frames before it.
TEST(Options, PrefetchedFramesSayWhatTheyLeaveOut) {
  temp_folder const folder;
  outcome const o = run_program(tracker, {generated(few), "--backend", "host", "--read-ahead", "2",
                                          "--out", folder.path("out")});
  ASSERT_TRUE(succeeded(o));
  results const r = read_results(folder.path("out"), few);
  int const prefetch = r.summary.at("prefetch");
  ASSERT_GT(prefetch, 0);
  EXPECT_TRUE(contains(o.out, "up to " + std::to_string(prefetch) + " frames are given ahead"));
  double const total = r.summary.at("stages").at("total").at("mean_ms");
  EXPECT_GT(r.summary.at("images_to_pose").at("mean_ms"), total);
  EXPECT_TRUE(r.summary.at("fps").is_null());
  EXPECT_GT(r.summary.at("wall_fps"), 0.0);
}

TEST(Options, AFolderThatCannotBeWrittenIsRefusedBeforeTheRun) {
  temp_folder const folder;
  std::ofstream(folder.path("file")) << "no folder";
  for (char const* out : {"file", "file/below"}) {
    outcome const o = track(generated(few), folder.path(out));
    EXPECT_TRUE(complained_of(o, "--out"));
    EXPECT_FALSE(contains(o.out, "frames/s"));
  }
  // A file of the run that is something else.
  fs::create_directories(folder.path("out/summary.json"));
  outcome const o = track(generated(few), folder.path("out"));
  EXPECT_TRUE(complained_of(o, "summary.json is there and cannot be written"));
  EXPECT_FALSE(contains(o.out, "frames/s"));
  EXPECT_FALSE(fs::exists(folder.path("out/trajectory.txt")));
  // Nothing is left of the attempt to write.
  EXPECT_EQ(std::distance(fs::directory_iterator(folder.path("out")), {}), 1);
}

TEST(Options, MissingCalibrationPointsToTheOption) {
  temp_folder const folder;
  write_kitti(generated(few), folder.path("kitti"), 0.05);
  fs::remove(folder.path("kitti/calib.txt"));
  EXPECT_TRUE(complained_of(track(folder.path("kitti"), folder.path("out")), "--calibration"));
  for (char const* file : {"cam0/sensor.yaml", "cam1/sensor.yaml"}) {
    spoilt_sequence const s(few);
    fs::remove(s.path(file));
    outcome const o = track(s.path(), s.out());
    EXPECT_TRUE(complained_of(o, "--calibration"));
    EXPECT_TRUE(complained_of(o, file));
  }
}

TEST(Options, OutIsNotTheSequence) {
  spoilt_sequence const s(few);
  EXPECT_TRUE(complained_of(track(s.path(), s.path()), "--out"));
  EXPECT_TRUE(complained_of(track(s.path(), s.path() + "/mav0"), "--out"));
  temp_folder const folder;
  write_kitti(generated(few), folder.path("kitti"), 0.05);
  std::string const truth = read_file(folder.path("kitti/groundtruth.txt"));
  EXPECT_TRUE(complained_of(track(folder.path("kitti"), folder.path("kitti")), "--out"));
  EXPECT_EQ(read_file(folder.path("kitti/groundtruth.txt")), truth);
  for (char const* part :
       {"image_00/data/0.png", "image_02/data/0.png", "color.txt", "frame-000000.color.png"}) {
    temp_folder const other;
    other.write(part, "");
    other.write("groundtruth.txt", truth);
    EXPECT_TRUE(complained_of(track(folder.path("kitti"), other.path()), "--out")) << part;
    EXPECT_EQ(read_file(other.path("groundtruth.txt")), truth);
  }
  // Plain folders have no mark.
  std::string const images = folder.path("images");
  fs::rename(folder.path("kitti"), images);
  fs::rename(images + "/image_0", images + "/left");
  fs::rename(images + "/image_1", images + "/right");
  outcome const o = track(images, images + "/../images", {"--fps", "20"});
  EXPECT_TRUE(complained_of(o, "is the folder of a sequence"));
  EXPECT_EQ(read_file(images + "/groundtruth.txt"), truth);
}

TEST(Track, KittisColourImages) {
  temp_folder const folder;
  std::string const kitti = folder.path("kitti");
  write_kitti(generated(few), kitti, 0.05);
  ASSERT_TRUE(succeeded(track(kitti, folder.path("grey"))));
  fs::rename(kitti + "/image_0", kitti + "/image_2");
  fs::rename(kitti + "/image_1", kitti + "/image_3");
  std::string calib = read_file(kitti + "/calib.txt");
  calib.replace(calib.find("P0:"), 3, "P2:");
  calib.replace(calib.find("P1:"), 3, "P3:");
  folder.write("kitti/calib.txt", calib);
  ASSERT_TRUE(succeeded(track(kitti, folder.path("colour"))));
  EXPECT_EQ(read_results(folder.path("colour"), few).number("tracked"), few);
  EXPECT_EQ(read_file(folder.path("colour/trajectory.txt")),
            read_file(folder.path("grey/trajectory.txt")));
}

}  // namespace

// SPDX-License-Identifier: Apache-2.0
/// @file The programs track_sequence and generate_sequence, run as child processes: what they
/// write, how far the path is off, and that every bad input ends in a message, never in a crash.
///
/// All on the host executor: these tests need no device.
#include <gtest/gtest.h>
#include <unistd.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>
#include <string>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/end_to_end/process.hpp"
#include "tests/end_to_end/track_support.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/sequence.hpp"

namespace {

using namespace app_test;

// ---- the helper

TEST(Process, TellsSignalsFromStatuses) {
  outcome const crash = run_program("/bin/sh", {"-c", "echo before; kill -SEGV $$"});
  EXPECT_EQ(crash.signal, SIGSEGV);
  EXPECT_EQ(crash.status, -1);
  EXPECT_EQ(crash.out, "before\n");
  EXPECT_FALSE(succeeded(crash));
  EXPECT_FALSE(complained_of(crash, ""));
  EXPECT_FALSE(refused_option(crash, ""));

  outcome const error = run_program("/bin/sh", {"-c", "echo 'track_sequence: x: y' >&2; exit 3"});
  EXPECT_EQ(error.signal, 0);
  EXPECT_EQ(error.status, 3);
  EXPECT_EQ(error.err, "track_sequence: x: y\n");
  EXPECT_TRUE(complained_of(error, "x"));
  EXPECT_FALSE(complained_of(error, "z"));
  EXPECT_FALSE(succeeded(error));

  // As a shell reports a crash of its child.
  outcome const passed_on =
      run_program("/bin/sh", {"-c", "echo 'track_sequence: x' >&2; exit 139"});
  EXPECT_FALSE(complained_of(passed_on, "x"));

  outcome const two_lines =
      run_program("/bin/sh", {"-c", "printf 'track_sequence: x\\ny\\n' >&2; exit 1"});
  EXPECT_FALSE(complained_of(two_lines, "x"));

  outcome const slow = run_program("/bin/sleep", {"60"}, std::chrono::seconds(0));
  EXPECT_TRUE(slow.timed_out);
  EXPECT_EQ(slow.signal, SIGKILL);

  EXPECT_TRUE(succeeded(run_program("/bin/true", {})));
  EXPECT_THROW(run_program("/nonexistent/program", {}), std::runtime_error);
}

TEST(Report, OutsideReferencesAreFound) {
  for (char const* inside :
       {"<svg xmlns=\"http://www.w3.org/2000/svg\"><use href='#a'/></svg>",
        "<img src=\"data:image/png;base64,AAAA\">", "a { fill: url(#b) }", "<p>report</p>"}) {
    EXPECT_EQ(outside_references(inside), strings{}) << inside;
  }
  for (char const* outside :
       {"<script src=\"plot.js\"></script>", "<img src=\"https://example.org/a.png\">",
        "<link rel=stylesheet>", "a { background: url('b.png') }", "@import 'x.css';",
        "<a href=\"http://example.org\">", "<script>fetch('data.json')</script>"}) {
    EXPECT_NE(outside_references(outside), strings{}) << outside;
  }
}

// ---- what must work

TEST(Track, GeneratedSequence) {
  temp_folder const folder;
  // With all threads, as by default.
  outcome const o = track(generated(many), folder.path("out"), {"--threads", "0"});
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "report.html"));
  results const r = read_results(folder.path("out"), many);
  EXPECT_EQ(r.number("tracked"), many);
  EXPECT_EQ(r.number("lost"), 0);
  EXPECT_EQ(r.number("dropped"), 0);
  EXPECT_GE(r.number("keyframes"), 1);
  EXPECT_GE(r.number("map_points"), 100);
  EXPECT_LT(r.summary.at("ate_rmse_m").get<double>(), 0.02);
  EXPECT_LT(r.summary.at("rpe_rmse_m").get<double>(), 0.05);

  auto const sequence = seq::sequence::open(generated(many));
  EXPECT_LT(largest_drift(r.path, sequence.ground_truth()), 0.1);
  for (int i = 0; i < many; ++i) {
    EXPECT_EQ(r.path.at(static_cast<std::size_t>(i)).time_ns, sequence.time_ns(i));
  }
  auto const error = seq::evaluate(r.path, sequence.ground_truth(), true);
  EXPECT_NEAR(*error.ate_rmse_m, r.summary.at("ate_rmse_m").get<double>(), 1e-6);
  EXPECT_NEAR(error.path_m, r.summary.at("path_m").get<double>(), 1e-6);
  EXPECT_GT(error.truth_path_m, 1.0) << "the sequence is one that moves";
}

TEST(Track, GeneratedFisheyeSequence) {
  temp_folder const folder;
  std::string const sequence =
      generated(26, {"--rig", "fisheye", "--width", "320", "--height", "320"});
  seq::open_options rectified;
  rectified.keep_fisheye = false;
  ASSERT_TRUE(succeeded(track(sequence, folder.path("out"), {"--rig", "rectified"})));
  results const r = read_results(folder.path("out"), 26);
  EXPECT_EQ(r.number("tracked"), 26);
  EXPECT_LT(r.summary.at("ate_rmse_m").get<double>(), 0.05);
  EXPECT_LT(largest_drift(r.path, seq::sequence::open(sequence, rectified).ground_truth()), 0.05);

  for (strings const& options : {strings{}, {"--rig", "fisheye"}}) {
    ASSERT_TRUE(succeeded(track(sequence, folder.path("fisheye"), options)));
    results const f = read_results(folder.path("fisheye"), 26);
    EXPECT_EQ(f.number("tracked"), 26);
    EXPECT_LT(f.summary.at("ate_rmse_m").get<double>(), 0.05);
    EXPECT_LT(largest_drift(f.path, seq::sequence::open(sequence).ground_truth()), 0.05);
  }
}

// 23 m, whole pixels and a short baseline: depths from single pairs would make it 1 % too short.
/// One camera: its map begins when it moves, and fits the ground truth but for the scale.
void expect_one_camera_tracks(std::string const& sequence, int frames, bool scale_known) {
  temp_folder const folder;
  outcome const o =
      track(sequence, folder.path("out"), {"--threads", "0", "--rig", "monocular", "--timing"});
  ASSERT_TRUE(succeeded(o));
  json const summary = json::parse(read_file(folder.path("out/summary.json")));
  EXPECT_GE(summary.at("tracked").get<int>(), frames / 3);
  EXPECT_EQ(summary.at("maps"), 1);
  EXPECT_EQ(summary.at("scale").is_null(), scale_known);
  EXPECT_TRUE(summary.at("stages").contains("start"));
  EXPECT_FALSE(summary.at("stages").contains("stereo"));
  EXPECT_LT(summary.at("ate_rmse_m").get<double>(), 0.02);
  auto const path = seq::read_tum(folder.path("out/trajectory.txt"));
  auto const before = summary.at("without_scale").get<std::size_t>();
  EXPECT_EQ(path.size() + before, summary.at("tracked").get<std::size_t>());
  EXPECT_EQ(before > 0, scale_known);
  EXPECT_EQ(contains(o.out, "before the IMU told it: not in the trajectory"), scale_known);
  EXPECT_EQ(path.size(), summary.at("pairs").get<std::size_t>());
}
TEST(Track, OneCamera) { expect_one_camera_tracks(generated(many), many, false); }
TEST(Track, OneFisheyeCamera) {
  strings const rig = {"--rig", "fisheye", "--width", "320", "--height", "320"};
  expect_one_camera_tracks(generated(many, rig), many, false);
}
TEST(Track, OneCameraWithAnImuKnowsItsScale) {
  expect_one_camera_tracks(generated(120, {"--imu"}), 120, true);
}

TEST(Track, FisheyeLapKeepsItsScale) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  temp_folder const folder;
  std::string const sequence = generated(300, {"--rig", "fisheye"});
  ASSERT_TRUE(succeeded(track(sequence, folder.path("out"), {"--threads", "0"})));
  results const r = read_results(folder.path("out"), 300);
  EXPECT_EQ(r.number("tracked"), 300);
  EXPECT_LT(r.summary.at("ate_rmse_m").get<double>(), 0.03);
  auto const source = seq::sequence::open(sequence);
  auto const error = seq::evaluate(r.path, source.ground_truth(), true);
  EXPECT_GT(error.truth_path_m, 20);
  EXPECT_NEAR(error.path_m, error.truth_path_m, 0.005 * error.truth_path_m);
}

TEST(Options, FisheyeTrackingOfAPinholePair) {
  temp_folder const folder;
  EXPECT_TRUE(complained_of(track(generated(few), folder.path("out"), {"--rig", "fisheye"}),
                            "--rig fisheye"));
}

TEST(Track, KittiLayoutGivesTheSamePath) {
  temp_folder const folder;
  write_kitti(generated(many), folder.path("kitti"), 0.05);
  // KITTI's layout has no IMU.
  ASSERT_TRUE(succeeded(track(generated(many), folder.path("euroc_out"), {"--imu", "off"})));
  ASSERT_TRUE(succeeded(track(folder.path("kitti"), folder.path("kitti_out"))));
  results const euroc = read_results(folder.path("euroc_out"), many);
  results const kitti = read_results(folder.path("kitti_out"), many);
  EXPECT_EQ(kitti.number("tracked"), many);
  EXPECT_LT(kitti.summary.at("ate_rmse_m").get<double>(), 0.05);
  EXPECT_NEAR(kitti.summary.at("ate_rmse_m").get<double>(),
              euroc.summary.at("ate_rmse_m").get<double>(), 1e-4);
  EXPECT_NEAR(kitti.summary.at("path_m").get<double>(), euroc.summary.at("path_m").get<double>(),
              1e-3);
}

TEST(Track, WithoutGroundTruth) {
  spoilt_sequence const s(few);
  fs::remove_all(s.path("state_groundtruth_estimate0"));
  ASSERT_TRUE(succeeded(track(s.path(), s.out())));
  results const r = read_results(s.out(), few);
  EXPECT_EQ(r.number("tracked"), few);
  EXPECT_TRUE(r.summary.at("ate_rmse_m").is_null());
  EXPECT_TRUE(r.summary.at("rpe_rmse_m").is_null());
}

TEST(Track, SameBytesInEveryRun) {
  temp_folder const folder;
  std::string first;
  for (strings const& options :
       {strings{"--threads", "1"}, {"--threads", "1"}, {"--threads", "2"}, {"--threads", "3"}}) {
    ASSERT_TRUE(succeeded(track(generated(many), folder.path("out"), options)));
    std::string const bytes = read_file(folder.path("out/trajectory.txt"));
    if (first.empty()) { first = bytes; }
    EXPECT_EQ(bytes, first) << "threads " << options[1];
  }
  EXPECT_EQ(lines_of(first).size(), static_cast<std::size_t>(many) + 1);
}

TEST(Track, RealtimeDropsFramesThatComeTooFast) {
  temp_folder const folder;
  std::string const fast = generated(many, {"--width", "376", "--height", "240", "--fps", "1000"});
  ASSERT_TRUE(succeeded(track(fast, folder.path("out"), {"--realtime"})));
  results const r = read_results(folder.path("out"), many);
  EXPECT_GT(r.number("dropped"), 0);
  EXPECT_GE(r.number("frames"), 2);
  EXPECT_EQ(r.number("tracked"), r.number("frames"));
  EXPECT_EQ(r.times.front().at("index"), "0");
  EXPECT_EQ(r.times.back().at("index"), std::to_string(many - 1)) << "the newest frame is taken";
}

TEST(Track, RealtimeDropsNothingWhereThereIsTime) {
  temp_folder const folder;
  write_kitti(generated(few), folder.path("slow"), 1000);
  ASSERT_TRUE(succeeded(track(folder.path("slow"), folder.path("out"), {"--realtime"})));
  results const r = read_results(folder.path("out"), few);
  EXPECT_EQ(r.number("dropped"), 0);
  EXPECT_EQ(r.number("frames"), few);
}

TEST(Track, DroppedFramesCostNoOthers) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  strings const walk{"--width", "376", "--height", "240", "--fps", "15"};
  for (int const every : {5, 7, 9}) {
    spoilt_sequence const s(150, walk);
    int const left = s.drop([&](int i) { return i >= 15 && (i - 15) % every == 0; });
    ASSERT_LT(left, 150 - 10);
    ASSERT_TRUE(succeeded(track(s.path(), s.out())));
    results const r = read_results(s.out(), left);
    EXPECT_EQ(r.number("lost"), 0) << every;
    EXPECT_LT(r.summary.at("ate_rmse_m").get<double>(), 0.05) << every;
  }
}

// The camera turns by degrees a frame where it sees again: nothing is known of its motion.
TEST(Track, AfterALongGapOneNewMapIsEnough) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  std::string const sequence =
      generated(200, {"--width", "564", "--height", "360", "--drop", "0.1", "9.15"});
  temp_folder const folder;
  ASSERT_TRUE(succeeded(track(sequence, folder.path("out"))));
  results const r = read_results(folder.path("out"), 19);
  int const patience = 5;
  EXPECT_LE(r.number("lost"), patience);
  EXPECT_LE(r.number("maps"), 2);
}

TEST(Track, StopsAfterTheFramesAskedFor) {
  temp_folder const folder;
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"), {"--frames", "3"})));
  EXPECT_EQ(read_results(folder.path("out"), 3).number("tracked"), 3);
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"), {"--frames", "1000"})));
  EXPECT_EQ(read_results(folder.path("out"), few).number("tracked"), few);
}

TEST(Track, QuietShowsNoProgress) {
  temp_folder const folder;
  outcome const loud = track(generated(few), folder.path("out"));
  outcome const quiet = track(generated(few), folder.path("out"), {"--quiet"});
  ASSERT_TRUE(succeeded(loud));
  ASSERT_TRUE(succeeded(quiet));
  EXPECT_TRUE(contains(loud.out, "frames/s  ETA"));
  EXPECT_FALSE(contains(quiet.out, "ETA"));
}

TEST(Track, OneFeature) {
  temp_folder const folder;
  outcome const o = track(generated(few), folder.path("out"), {"--features", "1"});
  EXPECT_TRUE(succeeded(o) || complained_of(o, "--features 1")) << o;
  read_results(folder.path("out"), few);
}

TEST(Track, HundredThousandFeatures) {
  temp_folder const folder;
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"), {"--features", "100000"})));
  EXPECT_EQ(read_results(folder.path("out"), few).number("tracked"), few);
}

TEST(Track, OnePair) {
  spoilt_sequence const s(few);
  for (int camera = 0; camera < 2; ++camera) {
    for (int i = 1; i < few; ++i) { fs::remove(s.image(camera, i)); }
  }
  ASSERT_TRUE(succeeded(track(s.path(), s.out())));
  results const r = read_results(s.out(), 1);
  EXPECT_EQ(r.number("tracked"), 1);
  EXPECT_TRUE(r.summary.at("ate_rmse_m").is_null());
}

TEST(Track, WritesOverAnOlderRun) {
  temp_folder const folder;
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("a/b/out"))));
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("a/b/out"), {"--frames", "2"})));
  EXPECT_EQ(read_results(folder.path("a/b/out"), 2).number("tracked"), 2);
}

// ---- pictures with nothing to see

/// Neither a crash nor nonsense: the run succeeds with consistent files, or says what is wrong.
void expect_orderly_end(outcome const& o, spoilt_sequence const& s) {
  EXPECT_TRUE(succeeded(o) || complained_of(o, s.path())) << o;
  read_results(s.out(), s.size());
}

TEST(NothingToSee, AllBlack) {
  spoilt_sequence const s(few);
  for (int i = 0; i < few; ++i) { s.set_pair(i, plain(0), plain(0)); }
  EXPECT_TRUE(complained_of(track(s.path(), s.out()), s.path()));
  results const r = read_results(s.out(), few);
  EXPECT_EQ(r.number("lost"), few);
  EXPECT_TRUE(r.summary.at("ate_rmse_m").is_null());
}

TEST(NothingToSee, AllWhite) {
  spoilt_sequence const s(few);
  for (int i = 0; i < few; ++i) { s.set_pair(i, plain(255), plain(255)); }
  EXPECT_TRUE(complained_of(track(s.path(), s.out()), s.path()));
  EXPECT_EQ(read_results(s.out(), few).number("lost"), few);
}

TEST(NothingToSee, RightCameraCovered) {
  spoilt_sequence const s(few);
  for (int i = 0; i < few; ++i) { seq::write_png(s.image(1, i), plain(0)); }
  EXPECT_TRUE(complained_of(track(s.path(), s.out()), s.path()));
  EXPECT_EQ(read_results(s.out(), few).number("lost"), few);
}

TEST(NothingToSee, Noise) {
  spoilt_sequence const s(12);
  for (int i = 0; i < s.size(); ++i) {
    auto const seed = static_cast<unsigned>(i);
    s.set_pair(i, noise(2 * seed), noise(2 * seed + 1));
  }
  expect_orderly_end(track(s.path(), s.out()), s);
}

TEST(NothingToSee, SameNoiseInBothCameras) {
  spoilt_sequence const s(12);
  for (int i = 0; i < s.size(); ++i) {
    seq::image const picture = noise(static_cast<unsigned>(i));
    s.set_pair(i, picture, picture);
  }
  expect_orderly_end(track(s.path(), s.out()), s);
}

TEST(NothingToSee, SamePictureInBothCameras) {
  spoilt_sequence const s(few);
  for (int i = 0; i < few; ++i) {
    fs::copy_file(s.image(0, i), s.image(1, i), fs::copy_options::overwrite_existing);
  }
  expect_orderly_end(track(s.path(), s.out()), s);
}

TEST(NothingToSee, CamerasSwapped) {
  spoilt_sequence const s(few);
  fs::rename(s.path("cam0/data"), s.path("spare"));
  fs::rename(s.path("cam1/data"), s.path("cam0/data"));
  fs::rename(s.path("spare"), s.path("cam1/data"));
  expect_orderly_end(track(s.path(), s.out()), s);
}

TEST(NothingToSee, PictureAfterPictureUnrelated) {
  spoilt_sequence const s(12);
  for (int i = 0; i < s.size(); ++i) {  // turned by 180 degrees every other time, left and right
    if (i % 2 == 0) { continue; }
    seq::image left = seq::read_image(s.image(0, i));
    seq::image right = seq::read_image(s.image(1, i));
    std::reverse(left.pixels.begin(), left.pixels.end());
    std::reverse(right.pixels.begin(), right.pixels.end());
    s.set_pair(i, right, left);  // keeps disparities positive
  }
  expect_orderly_end(track(s.path(), s.out()), s);
}

/// Frames 22 to 26, while the camera moves, are replaced: they are lost, and found again are those
/// after them, in the same map.
void expect_recovery(std::function<seq::image(unsigned)> const& picture) {
  constexpr int begin = 22;
  constexpr int end = 27;
  spoilt_sequence const s(many);
  for (int i = begin; i < end; ++i) {
    auto const seed = static_cast<unsigned>(i);
    s.set_pair(i, picture(2 * seed), picture(2 * seed + 1));
  }
  ASSERT_TRUE(succeeded(track(s.path(), s.out())));
  results const r = read_results(s.out(), many);
  for (int i = 0; i < many; ++i) { EXPECT_EQ(r.tracked(i), i < begin || i >= end) << i; }
  EXPECT_EQ(r.number("lost"), end - begin);
  EXPECT_EQ(r.number("tracked"), many - (end - begin));
  EXPECT_LT(largest_drift(r.path, seq::sequence::open(s.path()).ground_truth()), 0.1);
}

TEST(NothingToSee, RecoversFromBlackFrames) {
  expect_recovery([](unsigned) { return plain(0); });
}
TEST(NothingToSee, RecoversFromWhiteFrames) {
  expect_recovery([](unsigned) { return plain(255); });
}
TEST(NothingToSee, RecoversFromNoise) {
  expect_recovery([](unsigned seed) { return noise(seed); });
}

TEST(NothingToSee, BlackAtFirst) {
  spoilt_sequence const s(few);
  for (int i = 0; i < 3; ++i) { s.set_pair(i, plain(0), plain(0)); }
  ASSERT_TRUE(succeeded(track(s.path(), s.out())));
  results const r = read_results(s.out(), few);
  for (int i = 0; i < few; ++i) { EXPECT_EQ(r.tracked(i), i >= 3) << i; }
}

// ---- broken files

TEST(BrokenInput, Folders) {
  temp_folder const folder;
  std::string const out = folder.path("out");
  fs::create_directory(folder.path("empty"));
  folder.write("file", "not a folder");
  for (char const* name : {"missing", "empty", "file"}) {
    EXPECT_TRUE(complained_of(track(folder.path(name), out), folder.path(name)));
  }
}

TEST(BrokenInput, NoLists) {
  for (char const* name : {"cam0/data.csv", "cam1/data.csv"}) {
    spoilt_sequence const s(few);
    fs::remove(s.path(name));
    EXPECT_TRUE(complained_of(track(s.path(), s.out()), name));
    std::ofstream(s.path(name)) << "#timestamp [ns],filename\n";
    EXPECT_TRUE(complained_of(track(s.path(), s.out()), name));
    std::ofstream(s.path(name)) << "tomorrow,a.png\n";
    EXPECT_TRUE(complained_of(track(s.path(), s.out()), name));
  }
}

TEST(BrokenInput, NoSecondCamera) {
  spoilt_sequence const s(few);
  fs::remove_all(s.path("cam1"));
  for (char const* rig : {"stereo", "rectified", "fisheye"}) {
    EXPECT_TRUE(complained_of(track(s.path(), s.out(), {"--rig", rig}), "cam1"));
  }
}

TEST(BrokenInput, NoImages) {
  spoilt_sequence const s(few);
  fs::remove_all(s.path("cam0/data"));
  EXPECT_TRUE(complained_of(track(s.path(), s.out()), s.path()));
}

TEST(BrokenInput, TruncatedImage) {
  for (int camera = 0; camera < 2; ++camera) {
    spoilt_sequence const s(few);
    std::string const victim = s.image(camera, few / 2);
    fs::resize_file(victim, fs::file_size(victim) / 2);
    EXPECT_TRUE(complained_of(track(s.path(), s.out()), victim));
    fs::resize_file(victim, 0);
    EXPECT_TRUE(complained_of(track(s.path(), s.out()), victim));
    std::ofstream(victim) << "this is no image";
    EXPECT_TRUE(complained_of(track(s.path(), s.out()), victim));
  }
}

TEST(BrokenInput, ImageOfAnotherSize) {
  for (int frame : {0, few / 2}) {
    for (int camera = 0; camera < 2; ++camera) {
      spoilt_sequence const s(few);
      seq::write_png(s.image(camera, frame), plain(90, width / 2, height));
      EXPECT_TRUE(complained_of(track(s.path(), s.out()), s.image(camera, frame)));
      seq::write_png(s.image(camera, frame), plain(90, width, height + 1));
      EXPECT_TRUE(complained_of(track(s.path(), s.out()), s.image(camera, frame)));
    }
  }
}

TEST(BrokenInput, AllImagesTiny) {
  for (int side : {1, 8, 20, 40}) {
    spoilt_sequence const s(few);
    for (int i = 0; i < few; ++i) { s.set_pair(i, plain(90, side, side), plain(90, side, side)); }
    std::string const text = std::to_string(side);
    for (std::string const camera : {"cam0/", "cam1/"}) {
      s.set_line(camera + "sensor.yaml", "resolution", "resolution: [" + text + ", " + text + "]");
      s.set_line(camera + "sensor.yaml", "intrinsics",
                 "intrinsics: [" + text + ", " + text + ", 0.5, 0.5]");
    }
    EXPECT_TRUE(complained_of(track(s.path(), s.out()), s.path()));
  }
}

// A pair with a file missing is left out, as the reader says.
TEST(BrokenInput, MissingImage) {
  spoilt_sequence const s(few);
  fs::remove(s.image(1, 2));
  ASSERT_TRUE(succeeded(track(s.path(), s.out())));
  EXPECT_EQ(read_results(s.out(), few - 1).number("tracked"), few - 1);
}

struct bad_line {
  char const* name;
  char const* file;
  char const* key;
  char const* line;
  char const* named;  ///< in the message
};
std::ostream& operator<<(std::ostream& out, bad_line const& b) { return out << b.line; }

class BadCalibration : public testing::TestWithParam<bad_line> {};

TEST_P(BadCalibration, IsNamed) {
  bad_line const& b = GetParam();
  spoilt_sequence const s(few);
  s.set_line(b.file, b.key, b.line);
  EXPECT_TRUE(complained_of(track(s.path(), s.out()), b.named));
  EXPECT_FALSE(fs::exists(s.out() + "/summary.json"));
}

constexpr char const* cam0 = "cam0/sensor.yaml";
constexpr char const* cam1 = "cam1/sensor.yaml";
INSTANTIATE_TEST_SUITE_P(
    Lines, BadCalibration,
    testing::Values(
        bad_line{"ZeroFocal", cam0, "intrinsics", "intrinsics: [0, 217.5, 183, 125]", cam0},
        bad_line{"ZeroFocalRight", cam1, "intrinsics", "intrinsics: [217.5, 0, 183, 125]", cam1},
        bad_line{"NegativeFocal", cam0, "intrinsics", "intrinsics: [-217, 217.5, 183, 125]", cam0},
        bad_line{"NanFocal", cam0, "intrinsics", "intrinsics: [nan, 217.5, 183, 125]", cam0},
        bad_line{"YamlNanFocal", cam0, "intrinsics", "intrinsics: [.nan, 217.5, 183, 125]", cam0},
        bad_line{"InfiniteCentre", cam1, "intrinsics", "intrinsics: [217.5, 217.5, inf, 9]", cam1},
        bad_line{"ThreeIntrinsics", cam0, "intrinsics", "intrinsics: [217.5, 217.5, 183]", cam0},
        bad_line{"NoIntrinsics", cam0, "intrinsics", "", cam0},
        bad_line{"NanPose", cam1, "  data", "  data: [nan, 0, 0, 0,", cam1},
        bad_line{"NoRotation", cam1, "  data", "  data: [2, 0, 0, 0,", cam1},
        bad_line{"AnotherSize", cam0, "resolution", "resolution: [752, 480]", "752"},
        bad_line{"NoSize", cam0, "resolution", "resolution: [0, 0]", cam0},
        bad_line{"NegativeSize", cam0, "resolution", "resolution: [-376, 240]", cam0},
        bad_line{"HugeSize", cam0, "resolution", "resolution: [1e12, 1e12]", cam0},
        bad_line{"UnknownModel", cam0, "distortion_model", "distortion_model: cubist", cam0},
        bad_line{"WildDistortion", cam0, "distortion_coeff",
                 "distortion_coefficients: [1e9, 1e9, 0, 0]", cam0},
        bad_line{"NotYaml", cam0, "rate_hz", "rate_hz: [[[{", cam0}),
    [](auto const& instance) { return std::string(instance.param.name); });

TEST(BrokenInput, Baselines) {
  {
    spoilt_sequence const s(few);  // zero: both cameras in one place
    fs::copy_file(s.path(cam0), s.path(cam1), fs::copy_options::overwrite_existing);
    outcome const o = track(s.path(), s.out());
    EXPECT_TRUE(complained_of(o, "sensor.yaml"));
    EXPECT_TRUE(complained_of(o, "baseline"));
  }
  {
    spoilt_sequence const s(few);  // negative: the right camera on the left
    fs::rename(s.path(cam0), s.path("spare"));
    fs::rename(s.path(cam1), s.path(cam0));
    fs::rename(s.path("spare"), s.path(cam1));
    outcome const o = track(s.path(), s.out());
    EXPECT_TRUE(complained_of(o, s.path()));
    EXPECT_TRUE(complained_of(o, "baseline"));
  }
  temp_folder const folder;
  std::string const kitti = folder.path("kitti");
  write_kitti(generated(few), kitti, 0.05);
  auto const track_with = [&](std::string const& p1_3) {
    folder.write("kitti/calib.txt",
                 "P0: 217.5 0 183.35 0 0 217.5 125.7 0 0 0 1 0\nP1: 217.5 0 183.35 " + p1_3 +
                     " 0 217.5 125.7 0 0 0 1 0\n");
    return track(kitti, folder.path("out"));
  };
  for (char const* text : {"0", "nan", "-inf", "1e9"}) {
    EXPECT_TRUE(complained_of(track_with(text), "calib.txt")) << text;
  }
  outcome const swapped = track_with("23.925");
  EXPECT_TRUE(complained_of(swapped, kitti));
  EXPECT_TRUE(complained_of(swapped, "baseline"));
  EXPECT_TRUE(succeeded(track_with("-23.925")));
  fs::remove(kitti + "/calib.txt");
  EXPECT_TRUE(complained_of(track(kitti, folder.path("out")), "calib.txt"));
}

/// An ORB-SLAM3 settings file of the generated rig, with one line added or replaced.
std::string settings(std::string const& key = {}, std::string const& value = {}) {
  std::map<std::string, std::string> values{{"Camera.type", "\"Rectified\""},
                                            {"Camera1.fx", "217.5"},
                                            {"Camera1.fy", "217.5"},
                                            {"Camera1.cx", "183.35"},
                                            {"Camera1.cy", "125.7"},
                                            {"Camera.width", "376"},
                                            {"Camera.height", "240"},
                                            {"Camera.fps", "20"},
                                            {"Stereo.b", "0.11"},
                                            {"Stereo.ThDepth", "40.0"},
                                            {"ORBextractor.nFeatures", "1000"},
                                            {"ORBextractor.scaleFactor", "1.2"},
                                            {"ORBextractor.nLevels", "8"},
                                            {"ORBextractor.iniThFAST", "20"},
                                            {"ORBextractor.minThFAST", "7"}};
  if (!key.empty()) { values[key] = value; }
  std::string text = "%YAML:1.0\n";
  for (auto const& [name, v] : values) { text += name + ": " + v + "\n"; }
  return text;
}

TEST(BrokenInput, SettingsFiles) {
  temp_folder const folder;
  strings const options{"--calibration", folder.path("settings.yaml")};
  folder.write("settings.yaml", settings());
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"), options)));
  EXPECT_EQ(read_results(folder.path("out"), few).number("tracked"), few);

  struct {
    char const* key;
    strings values;
  } const bad[] = {{"Camera1.fx", {"0", "-217.5", "nan", ".inf", "", "abc", "1e9"}},
                   {"Camera.width", {"0", "-376", "1e9"}},
                   {"Stereo.b", {"0", "-0.11", "nan", "1e-9", "1e9"}},
                   {"Stereo.ThDepth", {"0", "-1", "nan", "1e30"}},
                   {"ORBextractor.nFeatures", {"0", "-5", "1.5", "2147483648"}},
                   {"ORBextractor.nLevels", {"0", "-1", "17", "24", "32", "33"}},
                   {"ORBextractor.scaleFactor", {"1", "0", "-1.2", "nan", "4", "1e9"}},
                   {"ORBextractor.iniThFAST", {"0", "-1", "256"}},
                   {"ORBextractor.minThFAST", {"0", "-1", "256"}}};
  for (auto const& [key, values] : bad) {
    for (std::string const& value : values) {
      folder.write("settings.yaml", settings(key, value));
      outcome const o = track(generated(few), folder.path("out"), options);
      EXPECT_TRUE(complained_of(o, "settings.yaml")) << key << ": " << value;
    }
  }
  for (auto const& [key, value] :
       {std::pair("ORBextractor.nLevels", "1"), std::pair("ORBextractor.nLevels", "16"),
        std::pair("ORBextractor.scaleFactor", "1.001"), std::pair("ORBextractor.iniThFAST", "1"),
        std::pair("ORBextractor.iniThFAST", "255"), std::pair("Camera.fps", "0")}) {
    folder.write("settings.yaml", settings(key, value));
    outcome const o = track(generated(few), folder.path("out"), options);
    EXPECT_TRUE(succeeded(o) || complained_of(o, "settings.yaml")) << key << ": " << value << o;
  }
}

TEST(BrokenInput, CalibrationOption) {
  temp_folder const folder;
  folder.write("size.yaml", settings("Camera.width", "375"));
  EXPECT_TRUE(complained_of(
      track(generated(few), folder.path("out"), {"--calibration", folder.path("size.yaml")}),
      "375 x 240"));
  folder.write("empty.yaml", "");
  folder.write("other.yaml", "%YAML:1.0\nanswer: 42\n");
  folder.write("binary.yaml", std::string("\0\x01\xff\xfe{[\x80", 7));
  for (char const* name : {"missing.yaml", "empty.yaml", "other.yaml", "binary.yaml"}) {
    EXPECT_TRUE(complained_of(
        track(generated(few), folder.path("out"), {"--calibration", folder.path(name)}), name));
  }
}

// ---- options

struct bad_option {
  char const* name;
  strings arguments;
  char const* named;
};
std::ostream& operator<<(std::ostream& out, bad_option const& b) { return out << b.name; }

class BadOption : public testing::TestWithParam<bad_option> {};

TEST_P(BadOption, IsRefused) {
  temp_folder const folder;
  bad_option const& b = GetParam();
  EXPECT_TRUE(refused_option(track(generated(few), folder.path("out"), b.arguments), b.named));
  EXPECT_FALSE(fs::exists(folder.path("out")));
}

INSTANTIATE_TEST_SUITE_P(
    Options, BadOption,
    testing::Values(
        bad_option{"Unknown", {"--bogus"}, "--bogus"}, bad_option{"Stray", {"stray"}, "stray"},
        bad_option{"NoFeatures", {"--features", "0"}, "--features"},
        bad_option{"NegativeFeatures", {"--features", "-3"}, "--features"},
        bad_option{"TextFeatures", {"--features", "many"}, "--features"},
        bad_option{"FractionalFeatures", {"--features", "1.5"}, "--features"},
        bad_option{"HugeFeatures", {"--features", "99999999999"}, "--features"},
        bad_option{"MissingValue", {"--features"}, "--features"},
        bad_option{"NegativeThreads", {"--threads", "-1"}, "--threads"},
        bad_option{"ManyThreads", {"--threads", "5000"}, "--threads"},
        bad_option{"NegativeFrames", {"--frames", "-1"}, "--frames"},
        bad_option{"NegativeNear", {"--near", "-1"}, "--near"},
        bad_option{"ZeroNear", {"--near", "0"}, "--near"},
        bad_option{"NanNear", {"--near", "nan"}, "--near"},
        bad_option{"InfiniteNear", {"--near", "inf"}, "--near"},
        bad_option{"NegativeReadout", {"--readout", "-1"}, "--readout"},
        bad_option{"NanReadout", {"--readout", "nan"}, "--readout"},
        bad_option{"LongReadout", {"--readout", "101"}, "--readout"},
        bad_option{"Rig", {"--rig", "tripod"}, "--rig"},
        bad_option{"NegativeDifference", {"--max-time-difference", "-1"}, "--max-time-difference"},
        bad_option{"NanDifference", {"--max-time-difference", "nan"}, "--max-time-difference"},
        bad_option{"ZeroUnit", {"--depth-unit", "0"}, "--depth-unit"},
        bad_option{"LargeUnit", {"--depth-unit", "5000"}, "--depth-unit"},
        bad_option{"NanUnit", {"--depth-unit", "nan"}, "--depth-unit"},
        bad_option{"NegativeDepth", {"--min-depth", "-1"}, "--min-depth"},
        bad_option{"DepthRange", {"--min-depth", "3", "--max-depth", "2"}, "--max-depth"},
        bad_option{"NanDepth", {"--max-depth", "nan"}, "--max-depth"},
        bad_option{"Backend", {"--backend", "abacus"}, "--backend"},
        bad_option{"ReadAhead", {"--read-ahead", "-1"}, "--read-ahead"},
        bad_option{"Frame", {"--frame", "wheel"}, "--frame"},
        bad_option{"Poses", {"--poses", "euler"}, "--poses"}),
    [](auto const& instance) { return std::string(instance.param.name); });

TEST(Options, SequenceIsRequired) {
  EXPECT_TRUE(refused_option(run_program(tracker, {}), "--sequence"));
}

TEST(Options, HelpNamesThem) {
  outcome const o = run_program(tracker, {"--help"});
  ASSERT_TRUE(succeeded(o));
  for (char const* option :
       {"--sequence",   "--calibration", "--backend",   "--features",  "--near",
        "--threads",    "--frames",      "--realtime",  "--out",       "--quiet",
        "--rig",        "--depth-unit",  "--min-depth", "--max-depth", "--max-time-difference",
        "--read-ahead", "--frame",       "--poses",     "--timing",    "--version",
        "--readout",    "exit status"}) {
    EXPECT_TRUE(contains(o.out, option)) << option;
  }
}

TEST(Options, CudaWithoutDevice) {
  temp_folder const folder;
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("auto"), {"--backend", "auto"})));
  if (json::parse(read_file(folder.path("auto/summary.json"))).at("backend") == "cuda") {
    GTEST_SKIP() << "there is a GPU here";
  }
  EXPECT_TRUE(complained_of(track(generated(few), folder.path("cuda"), {"--backend", "cuda"}),
                            "--backend cuda"));
  EXPECT_FALSE(fs::exists(folder.path("cuda/summary.json")));
}

TEST(Options, OutThatCannotBeWritten) {
  temp_folder const folder;
  folder.write("file", "in the way");
  for (char const* name : {"file", "file/below"}) {
    EXPECT_TRUE(complained_of(track(generated(few), folder.path(name)), folder.path(name)));
  }
  EXPECT_EQ(read_file(folder.path("file")), "in the way");
  EXPECT_TRUE(complained_of(track(generated(few), "/proc/ft"), "/proc/ft"));
  if (::geteuid() != 0) {  // root may write anywhere
    fs::create_directory(folder.path("locked"));
    fs::permissions(folder.path("locked"), fs::perms::owner_read | fs::perms::owner_exec);
    EXPECT_TRUE(complained_of(track(generated(few), folder.path("locked")), "locked"));
  }
}

TEST(Options, FullDisk) {
  if (!fs::exists("/dev/full")) { GTEST_SKIP() << "no /dev/full here"; }
  for (char const* name : {"trajectory.txt", "groundtruth.txt", "map.ply", "times.csv",
                           "summary.json", "report.html"}) {
    temp_folder const folder;
    fs::create_directory(folder.path("out"));
    fs::create_symlink("/dev/full", folder.path("out/") + name);
    EXPECT_TRUE(complained_of(track(generated(few), folder.path("out")), name));
    fs::remove(folder.path("out/") + name);
    fs::create_directory(folder.path("out/") + name);
    EXPECT_TRUE(complained_of(track(generated(few), folder.path("out")), name));
  }
}

// ---- recorded data

TEST(Recorded, Kitti) {
  if (!test::whole_effort()) { GTEST_SKIP() << "FT_TEST_EFFORT asks for less"; }
  SEQ_TEST_SHARED_OR_SKIP(shared);
  temp_folder const folder;
  std::string const sequence = shared + "/data/kitti_0926_stereo";
  ASSERT_TRUE(succeeded(track(sequence, folder.path("out"), {"--threads", "0"})));
  results const r = read_results(folder.path("out"), 60);
  EXPECT_EQ(r.number("tracked"), 60);
  EXPECT_EQ(r.number("lost"), 0);
  EXPECT_LT(r.summary.at("ate_rmse_m").get<double>(), 0.15);

  seq::trajectory const truth = seq::read_tum(sequence + "/groundtruth.txt");
  double estimated_m = 0;
  double true_m = 0;
  for (std::size_t i = 1; i < r.path.size(); ++i) {
    auto const before = seq::interpolate(truth, r.path[i - 1].time_ns);
    auto const now = seq::interpolate(truth, r.path[i].time_ns);
    ASSERT_TRUE(before && now) << "no ground truth at pose " << i;
    true_m += (now->translation() - before->translation()).norm();
    estimated_m +=
        (r.path[i].T_world_camera.translation() - r.path[i - 1].T_world_camera.translation())
            .norm();
  }
  EXPECT_NEAR(true_m, 45.987, 0.01);
  EXPECT_NEAR(estimated_m, true_m, 0.01 * true_m);
}

TEST(Recorded, KittiByOneCamera) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  temp_folder const folder;
  std::string const sequence = shared + "/data/kitti_0926_stereo";
  outcome const o = track(sequence, folder.path("out"), {"--threads", "0", "--rig", "monocular"});
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "scale"));
  EXPECT_FALSE(contains(o.out, "warning"));
  // The map begins behind the first frame, whose camera its world is.
  json const summary = json::parse(read_file(folder.path("out/summary.json")));
  seq::trajectory const path = seq::read_tum(folder.path("out/trajectory.txt"));
  EXPECT_GE(summary.at("tracked").get<int>(), 55);
  EXPECT_EQ(path.size(), summary.at("tracked").get<std::size_t>());
  EXPECT_EQ(summary.at("maps"), 1);
  EXPECT_LT(summary.at("ate_rmse_m").get<double>(), 0.2);
  EXPECT_TRUE(contains(summary.at("evo").at("ATE RMSE").at("command").get<std::string>(),
                       "--correct_scale"));
  // The file has the path as it was found; its length times the scale is that of the summary.
  double length = 0;
  for (std::size_t i = 1; i < path.size(); ++i) {
    length +=
        (path[i].T_world_camera.translation() - path[i - 1].T_world_camera.translation()).norm();
  }
  double const scale = summary.at("scale").get<double>();
  EXPECT_GT(std::fabs(scale - 1.0), 0.1) << "a scale that tells nothing";
  EXPECT_NEAR(length * scale, summary.at("path_m").get<double>(), 1e-3);
}

TEST(Options, OneCameraHasNoBodyFrame) {
  temp_folder const folder;
  EXPECT_TRUE(complained_of(
      track(generated(few), folder.path("out"), {"--rig", "monocular", "--frame", "body"}),
      "--frame body"));
}

/// The rig stands still: how far does it seem to have gone?
void expect_standing_still(strings const& options) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  temp_folder const folder;
  strings arguments;
  for (std::string const& option : options) {
    arguments.push_back(option.rfind("golden/", 0) == 0 ? shared + "/" + option : option);
  }
  ASSERT_TRUE(
      succeeded(track(shared + "/data/euroc_v101_stereo_start", folder.path("out"), arguments)));
  results const r = read_results(folder.path("out"), 16);
  EXPECT_EQ(r.number("tracked"), 16);
  EXPECT_EQ(r.number("lost"), 0);
  for (auto const& pose : r.path) {
    Eigen::Vector3d const away =
        pose.T_world_camera.translation() - r.path.front().T_world_camera.translation();
    EXPECT_LT(away.norm(), 0.005) << pose.time_ns;
  }
}

TEST(Recorded, EurocStart) { expect_standing_still({}); }
TEST(Recorded, EurocStartWithSettingsFile) {
  expect_standing_still({"--calibration", "golden/euroc_v101_flight/settings.yaml"});
}

// Pictures seconds apart: nothing to track by, but no reason to fall over.
TEST(Recorded, EurocSparse) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  temp_folder const folder;
  std::string const sequence = shared + "/data/euroc_v101_stereo_sparse";
  outcome const o = track(sequence, folder.path("out"), {"--threads", "0"});
  EXPECT_TRUE(succeeded(o) || complained_of(o, sequence)) << o;
  results const r = read_results(folder.path("out"), 25);
  EXPECT_EQ(r.number("dropped"), 0);
}

// ---- recorded fisheye pairs

/// Rows of numbers in a calib.yaml: `key: [a, b, c]`, below the line `section:` where one is named.
std::vector<double> numbers_of(std::string const& file, std::string const& section,
                               std::string const& key) {
  bool here = section.empty();
  for (std::string const& line : lines_of(read_file(file))) {
    if (!section.empty() && !line.empty() && line[0] != ' ' && line[0] != '#') {
      here = line.rfind(section + ":", 0) == 0;
    }
    std::size_t const begin = line.find_first_not_of(' ');
    if (!here || begin == std::string::npos ||
        line.compare(begin, key.size() + 2, key + ": ") != 0) {
      continue;
    }
    std::size_t const open = line.find('[');
    std::vector<double> numbers;
    for (std::string const& field : split(line.substr(open + 1, line.find(']') - open - 1), ',')) {
      numbers.push_back(std::stod(field));
    }
    return numbers;
  }
  throw std::runtime_error(file + " has no " + section + " " + key);
}

struct fisheye_pairs {
  std::vector<std::array<std::string, 2>> files;  ///< left, right
  std::vector<double> left, left_k, right, right_k;
  Eigen::Isometry3d T_right_left = Eigen::Isometry3d::Identity();
  double interval_s = 1.0 / 30;
};

Eigen::Isometry3d refined_motion(std::string const& file, std::string const& section,
                                 double baseline) {
  auto const w = numbers_of(file, section, "rotvec_refined");
  auto const t = numbers_of(file, section, "t_dir_refined");
  Eigen::Vector3d const turn(w.at(0), w.at(1), w.at(2));
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
  T.translation() = baseline * Eigen::Vector3d(t.at(0), t.at(1), t.at(2)).normalized();
  return T;
}

/// Three consecutive pairs of a slanted scene at about 0.5 to 1.5 m, 1/30 s apart.
fisheye_pairs kapture(std::string const& shared) {
  std::string const root = shared + "/data/t265_kapture_stereo";
  std::string const calib = root + "/calib.yaml";
  fisheye_pairs p;
  strings names;
  for (auto const& file : fs::directory_iterator(root + "/mav0/cam0/data")) {
    names.push_back(file.path().filename().string());
  }
  std::sort(names.begin(), names.end());
  for (std::string const& name : names) {
    p.files.push_back({root + "/mav0/cam0/data/" + name, root + "/mav0/cam1/data/" + name});
  }
  p.left = numbers_of(calib, "", "left_fx_fy_cx_cy");
  p.left_k = numbers_of(calib, "", "left_k");
  p.right = numbers_of(calib, "", "right_fx_fy_cx_cy");
  p.right_k = numbers_of(calib, "", "right_k");
  p.T_right_left = refined_motion(calib, "", 0.064);
  return p;
}

/// One pair three times: the rig stands still.
fisheye_pairs standing(std::string const& shared, std::string const& section,
                       std::string const& name) {
  std::string const root = shared + "/data/t265_vfs_stereo/";
  std::string const calib = root + "calib.yaml";
  fisheye_pairs p;
  p.files.assign(3, {root + name + "1.png", root + name + "2.png"});
  p.left = numbers_of(calib, section, "left_fx_fy_cx_cy");
  p.left_k = numbers_of(calib, section, "left_k");
  p.right = numbers_of(calib, section, "right_fx_fy_cx_cy_refined");
  p.right_k = p.left_k;
  auto const t = numbers_of(calib, section, "t");
  p.T_right_left =
      refined_motion(calib, section, Eigen::Vector3d(t.at(0), t.at(1), t.at(2)).norm());
  return p;
}

/// Writes them in ASL layout.
std::string write_asl(fisheye_pairs const& p, std::string const& to) {
  for (std::size_t camera = 0; camera < 2; ++camera) {
    std::string const folder = to + "/mav0/cam" + std::to_string(camera);
    fs::create_directories(folder + "/data");
    std::ofstream rows(folder + "/data.csv");
    rows << "#timestamp [ns],filename\n";
    for (std::size_t i = 0; i < p.files.size(); ++i) {
      auto const stamp =
          std::to_string(1'000'000'000 + std::llround(1e9 * p.interval_s * static_cast<double>(i)));
      fs::copy_file(p.files[i][camera], folder + "/data/" + stamp + ".png");
      rows << stamp << "," << stamp << ".png\n";
    }
    auto const list = [](std::vector<double> const& values) {
      std::ostringstream text;
      text.precision(17);
      for (std::size_t i = 0; i < values.size(); ++i) {
        text << (i == 0 ? "[" : ", ") << values[i];
      }
      return text.str() + "]";
    };
    Eigen::Isometry3d const T =
        camera == 0 ? Eigen::Isometry3d::Identity() : p.T_right_left.inverse();
    std::vector<double> rows_of_T;
    for (int i = 0; i < 16; ++i) { rows_of_T.push_back(T.matrix()(i / 4, i % 4)); }
    seq::image const picture = seq::read_image(p.files[0][camera]);
    std::ofstream(folder + "/sensor.yaml")
        << "sensor_type: camera\nT_BS:\n  cols: 4\n  rows: 4\n  data: " << list(rows_of_T)
        << "\nrate_hz: " << 1 / p.interval_s << "\nresolution: [" << picture.width << ", "
        << picture.height
        << "]\ncamera_model: pinhole\nintrinsics: " << list(camera == 0 ? p.left : p.right)
        << "\ndistortion_model: equidistant\ndistortion_coefficients: "
        << list(camera == 0 ? p.left_k : p.right_k) << "\n";
  }
  return to;
}

/// Runs the tracker on the pairs. @return rows of times.csv
table track_pairs(fisheye_pairs const& p, temp_folder const& folder, std::string const& name) {
  outcome const o = track(write_asl(p, folder.path(name)), folder.path(name + "_out"),
                          {"--rig", "fisheye", "--threads", "0"});
  EXPECT_TRUE(succeeded(o) || complained_of(o, name)) << o;
  return read_times(folder.path(name + "_out/times.csv"));
}

/// Every frame is tracked; the left camera's pixels are found in the right one where the
/// calibration says, within what the octaves allow; with a right camera that is turned by 3 degrees
/// they are not.
void expect_consistent_pairs(fisheye_pairs const& p, int least_matches, double most_motion_m) {
  temp_folder const folder;
  table const rows = track_pairs(p, folder, "given");
  ASSERT_EQ(rows.size(), p.files.size());
  fisheye_pairs turned = p;
  turned.T_right_left.linear() =
      p.T_right_left.linear() * Eigen::AngleAxisd(0.05, Eigen::Vector3d::UnitX());
  table const rows_turned = track_pairs(turned, folder, "turned");
  ASSERT_EQ(rows_turned.size(), p.files.size());
  for (std::size_t i = 0; i < rows.size(); ++i) {
    auto const number = [](std::map<std::string, std::string> const& row, char const* column) {
      return std::stoi(row.at(column));
    };
    int const matches = number(rows[i], "stereo_matches");
    EXPECT_EQ(rows[i].at("tracked"), "1") << i;
    EXPECT_GE(matches, least_matches) << i;
    EXPECT_GE(2 * matches, 5 * number(rows_turned[i], "stereo_matches")) << i;
    // After the first frame map points count in each camera that sees them.
    if (i > 0) { EXPECT_GE(10 * number(rows[i], "inliers"), 18 * matches) << i; }
  }
  results const r = read_results(folder.path("given_out"), static_cast<int>(p.files.size()));
  for (auto const& pose : r.path) {
    EXPECT_LT(pose.T_world_camera.translation().norm(), most_motion_m) << pose.time_ns;
  }
}

// The cameras' own odometry moves by about 1.5 mm in this time.
TEST(Recorded, FisheyePairsInMotion) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  fisheye_pairs const p = kapture(shared);
  ASSERT_EQ(p.files.size(), 3u);
  expect_consistent_pairs(p, 150, 0.005);
}

TEST(Recorded, FisheyePairStandingStill) {
  SEQ_TEST_SHARED_OR_SKIP(shared);
  expect_consistent_pairs(standing(shared, "rig_robot_fs", "fs"), 280, 0.002);
  expect_consistent_pairs(standing(shared, "rig_wang", "wang"), 110, 0.002);
}

TEST(GenerateSequence, MistakesInItsOptionsEndItWithStatus2) {
  for (strings const& wrong :
       {strings{}, strings{"--out"}, strings{"--out", "x", "--no-such"},
        strings{"--out", "x", "--rig", "round"}, strings{"--out", "x", "--frames", "many"}}) {
    outcome const o = run_program(generator, wrong);
    EXPECT_EQ(o.signal, 0) << o;
    EXPECT_EQ(o.status, 2) << o;
    EXPECT_NE(o.err, "") << o;
  }
  EXPECT_TRUE(succeeded(run_program(generator, {"--help"})));
}

TEST(GenerateSequence, ImagesOfAnyPngLevelHaveTheSamePixels) {
  temp_folder const folder;
  auto const generate = [&](std::string const& level) {
    return run_program(generator, {"--out", folder.path(level), "--frames", "1", "--width", "96",
                                   "--height", "64", "--png-level", level});
  };
  strings files;
  for (std::string const level : {"0", "9"}) {
    outcome const o = generate(level);
    ASSERT_EQ(o.status, 0) << o;
    for (auto const& file : fs::directory_iterator(folder.path(level + "/mav0/cam0/data"))) {
      files.push_back(file.path().string());
    }
  }
  ASSERT_EQ(files.size(), 2u);
  EXPECT_GT(fs::file_size(files[0]), 96u * 64u);
  EXPECT_LT(fs::file_size(files[1]), 96u * 64u);
  EXPECT_EQ(seq::read_image(files[0]).pixels, seq::read_image(files[1]).pixels);
  EXPECT_EQ(generate("10").status, 2);
  EXPECT_EQ(generate("-1").status, 2);
}

}  // namespace

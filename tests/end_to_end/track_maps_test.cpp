// SPDX-License-Identifier: Apache-2.0
/// @file A map in one process, the camera found in it by another one: track_sequence --save-map and
/// --load-map with a pair, a pair with an IMU and a rig of four cameras, all on the host executor.
#include <gtest/gtest.h>
#include <sys/stat.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <filesystem>
#include <fstream>
#include <string>

#include "examples/sequence/asl_writer.hpp"
#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/generator.hpp"
#include "examples/sequence/image_io.hpp"
#include "tests/end_to_end/track_support.hpp"

namespace {

using namespace app_test;

constexpr double fps = 12;
constexpr int mapped_frames = 96;  // 8 s
constexpr int skipped = 26;        // the second run begins after 2.7 s,
constexpr int later_frames = 42;   // and ends after 4.3 s; the map was saved at 8 s

/// The second recording has the room and the way of the first one, other instants and noise.
strings recorded(bool second) {
  return {"--width", std::to_string(width), "--height", std::to_string(height),
          "--fps",   second ? "9.7" : "12", "--noise",  second ? "3" : "2"};
}

/// Its frames from `skipped` on.
void leave_begin_out(spoilt_sequence const& s) {
  ASSERT_EQ(s.drop([](int i) { return i < skipped; }), later_frames - skipped);
}

json summary_of(std::string const& out) { return json::parse(read_file(out + "/summary.json")); }

strings joined(strings a, strings const& b) {
  a.insert(a.end(), b.begin(), b.end());
  return a;
}

/// Largest distance of the positions of a run from the truth, in the world of another run.
double largest_error(std::string const& out, std::string const& mapped_out) {
  auto const truth_of = [](std::string const& run) {
    return seq::read_tum(run + "/groundtruth.txt");
  };
  auto const path_of = [](std::string const& run) {
    return seq::read_tum(run + "/trajectory.txt");
  };
  auto const T_truth_map =
      seq::evaluate(path_of(mapped_out), truth_of(mapped_out), true).T_truth_estimate;
  seq::trajectory const truth = truth_of(out);
  double largest = 0;
  for (auto const& pose : path_of(out)) {
    auto const at = seq::interpolate(truth, pose.time_ns);
    if (!at) {
      ADD_FAILURE() << "no ground truth at " << pose.time_ns;
      continue;
    }
    Eigen::Vector3d const p = T_truth_map * pose.T_world_camera.translation();
    largest = std::max(largest, (p - at->translation()).norm());
  }
  return largest;
}

/// From where a run begins to where the mapped one ended, metres.
double far_from_end(std::string const& out, std::string const& mapped_out) {
  auto const begin = seq::read_tum(out + "/groundtruth.txt").front();
  auto const end = seq::read_tum(mapped_out + "/groundtruth.txt").back();
  return (begin.T_world_camera.translation() - end.T_world_camera.translation()).norm();
}

/// What a viewer gets: the path of the map, that of the run from when a loop corrects it, and
/// loops.
void expect_corrected(std::string const& record, json const& edges) {
  json last;
  for (std::string const& line : lines_of(read_file(record + "/recording.jsonl"))) {
    json const frame = json::parse(line);
    if (frame.contains("corrected")) { last = frame.at("corrected"); }
  }
  ASSERT_TRUE(last.is_object());
  // A camera that goes on in the map needs no loop.
  EXPECT_EQ(last.at("path").size(), edges.empty() ? 1u : 2u);
  EXPECT_GT(last.at("path").at(0).size(), 5u);
  EXPECT_EQ(last.at("loops").size(), edges.size());
  for (json const& loop : last.at("loops")) {
    Eigen::Vector3d ends[2];
    for (std::size_t k = 0; k < 2; ++k) {
      for (int axis = 0; axis < 3; ++axis) { ends[k][axis] = loop.at(k).at(axis).get<double>(); }
    }
    EXPECT_LT((ends[1] - ends[0]).norm(), 2) << "a place is recognised from near it";
  }
}

/// Maps one recording, and is found in the map by the other one, elsewhere than where it was saved.
void expect_found(std::string const& mapped, std::string const& later, strings const& options) {
  temp_folder const folder;
  std::string const map = folder.path("room.map");
  strings const loops = joined({"--loops"}, options);
  outcome const first = track(mapped, folder.path("first"), joined(loops, {"--save-map", map}));
  ASSERT_TRUE(succeeded(first));
  EXPECT_TRUE(contains(first.out, "map       saved to " + map));
  outcome const second =
      track(later, folder.path("second"),
            joined(loops, {"--load-map", map, "--record", folder.path("record")}));
  ASSERT_TRUE(succeeded(second));
  int const frames = later_frames - skipped;
  json const summary = summary_of(folder.path("second"));
  ASSERT_TRUE(summary.at("loaded_map").at("found_after").is_number()) << second;
  int const after = summary.at("loaded_map").at("found_after");
  EXPECT_LE(after, 3);
  EXPECT_GT(far_from_end(folder.path("second"), folder.path("first")), 1)
      << "found where the map was saved: this tests nothing";
  EXPECT_TRUE(contains(second.out, "found after " + std::to_string(after) + " frame"));
  EXPECT_GE(summary.at("tracked").get<int>(), frames - 2);
  for (auto const& w : summary.at("warnings")) {
    EXPECT_FALSE(contains(w.get<std::string>(), "maps were begun")) << "they are joined: " << w;
  }
  table const rows = read_times(folder.path("second/times.csv"));
  ASSERT_EQ(static_cast<int>(rows.size()), frames);
  for (std::size_t i = static_cast<std::size_t>(after) - 1; i < rows.size(); ++i) {
    EXPECT_EQ(rows[i].at("map_id"), "1") << i;
  }
  expect_corrected(folder.path("record"), summary.at("loops").at("edges"));
  double const error = largest_error(folder.path("second"), folder.path("first"));
  testing::Test::RecordProperty("largest_error_mm", static_cast<int>(1e3 * error));
  EXPECT_LT(error, 0.03);
}

TEST(Maps, APairIsFoundInTheMapOfAnotherProcess) {
  spoilt_sequence const later(later_frames, recorded(true));
  leave_begin_out(later);
  expect_found(generated(mapped_frames, recorded(false)), later.path(), {"--imu", "off"});
}

/// The reason for which a run ended before its first frame.
void expect_refused(std::string const& map, std::string const& option, std::string const& reason,
                    strings const& options = {}) {
  temp_folder const folder;
  outcome const o = track(generated(few), folder.path("out"), joined({option, map}, options));
  EXPECT_TRUE(complained_of(o, option + " " + map + ": ")) << o;
  EXPECT_TRUE(complained_of(o, reason)) << o;
  EXPECT_FALSE(fs::exists(folder.path("out/trajectory.txt")));
}

TEST(Maps, AFileThatIsNoMapIsNamed) {
  temp_folder const folder;
  std::string const map = folder.path("room.map");
  expect_refused(map, "--load-map", "No such file");
  expect_refused(folder.write("text.map", "this is a text"), "--load-map", "not a map");
  expect_refused(folder.path(), "--load-map", "not a map");
  expect_refused(folder.path("none/room.map"), "--save-map", "No such file");
  expect_refused(folder.path(), "--save-map", "Is a directory");
  ASSERT_EQ(::mkfifo(folder.path("pipe").c_str(), 0600), 0);
  expect_refused(folder.path("pipe"), "--save-map", "not a plain file");
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"), {"--loops", "--save-map", map})));
  expect_refused(map, "--load-map", "saved with loops");
  expect_refused(map, "--load-map", "keypoints of an image", {"--loops", "--features", "500"});
  expect_refused(map, "--load-map", "rig", {"--loops", "--rig", "mono"});
  std::string const bytes = read_file(map);
  expect_refused(folder.write("cut.map", bytes.substr(0, bytes.size() / 2)), "--load-map",
                 "truncated", {"--loops"});
  // Nothing but the map stays, and a run that fails leaves an older one.
  std::string const black = folder.path("black");
  fs::copy(generated(few), black, fs::copy_options::recursive);
  for (char const* camera : {"cam0", "cam1"}) {
    for (auto const& file : fs::directory_iterator(black + "/mav0/" + camera + "/data")) {
      seq::write_png(file.path().string(), plain(0));
    }
  }
  EXPECT_EQ(track(black, folder.path("out"), {"--save-map", map}).status, 1);
  EXPECT_EQ(read_file(map), bytes);
  EXPECT_FALSE(fs::exists(map + ".partial"));
}

TEST(Maps, LocalizeOnlyIsInTheLoadedMapOrLost) {
  temp_folder const folder;
  std::string const map = folder.path("room.map"), out = folder.path("out");
  strings const small = {"--width", std::to_string(width), "--height", std::to_string(height)};
  ASSERT_TRUE(succeeded(track(generated(few), out, {"--save-map", map})));
  int const keyframes = summary_of(out).at("keyframes");
  strings const options = {"--load-map", map, "--localize-only", "--save-map", map + ".again"};
  ASSERT_TRUE(succeeded(track(generated(few), out, options)));
  EXPECT_EQ(summary_of(out).at("tracked"), few);
  EXPECT_EQ(summary_of(out).at("keyframes"), keyframes);
  EXPECT_EQ(summary_of(out).at("loaded_map").at("found_after"), 1);
  EXPECT_TRUE(read_file(map + ".again") == read_file(map));
  outcome const o = track(generated(few, joined(small, {"--seed", "7"})), out, options);
  EXPECT_EQ(o.status, 1);
  EXPECT_TRUE(complained_of(o, "the camera was not found in the map"));
  EXPECT_TRUE(refused_option(track(generated(few), out, {"--localize-only"}), "--load-map"));
}

TEST(Maps, ACameraThatIsNotInTheMapIsTold) {
  temp_folder const folder;
  std::string const map = folder.path("room.map");
  ASSERT_TRUE(succeeded(track(generated(few), folder.path("out"), {"--loops", "--save-map", map})));
  std::string const other = generated(
      few, {"--width", std::to_string(width), "--height", std::to_string(height), "--seed", "7"});
  outcome const o = track(other, folder.path("out"), {"--loops", "--load-map", map});
  ASSERT_TRUE(succeeded(o));
  EXPECT_TRUE(contains(o.out, "the camera was not found in it"));
  EXPECT_TRUE(contains(o.out, "warning: the camera was not found in the map " + map));
  EXPECT_TRUE(summary_of(folder.path("out")).at("loaded_map").at("found_after").is_null());
  EXPECT_EQ(read_times(folder.path("out/times.csv")).back().at("map_id"), "2");
}

TEST(Maps, WithAnImu) {
  spoilt_sequence const later(later_frames, recorded(true));
  leave_begin_out(later);
  expect_found(generated(mapped_frames, recorded(false)), later.path(), {});
}

// ---- four cameras

/// A second pair beside the first one, which looks 90 degrees to the left.
void write_four_cameras(std::string const& folder, bool second) {
  seq::generator_options o;
  o.width = width;
  o.height = height;
  o.frames = second ? later_frames : mapped_frames;
  o.fps = second ? 9.7 : fps;
  o.noise_sigma = second ? 3 : 2;
  seq::stereo_rig const pair = seq::generator(o).rig();
  Eigen::Isometry3d aside = Eigen::Isometry3d::Identity();
  aside.linear() = Eigen::AngleAxisd(-1.5707963, Eigen::Vector3d::UnitY()).toRotationMatrix();
  aside.translation() = Eigen::Vector3d(-0.1, 0, 0);
  o.further = {{pair.left, aside, -1, false}, {pair.right, aside * pair.T_left_right, 0, false}};
  seq::generator const source(o);
  seq::asl_options writing;
  writing.imu = false;
  writing.threads = 1;
  seq::write_asl(source, folder, writing);
  for (int k = 0; k < 2; ++k) {
    fs::path const camera = folder + "/mav0/cam" + std::to_string(2 + k);
    fs::create_directories(camera / "data");
    std::ofstream list(camera / "data.csv");
    for (int i = second ? skipped : 0; i < source.size(); ++i) {
      std::string const name = std::to_string(source.time_ns(i)) + ".png";
      list << source.time_ns(i) << "," << name << "\n";
      seq::write_png((camera / "data" / name).string(), source.render_further(i, k).grey);
    }
    seq::further_camera const& of = o.further[static_cast<std::size_t>(k)];
    Eigen::Matrix4d const T = (source.rig().T_body_left * of.T_left_this).matrix();
    std::ofstream sensor(camera / "sensor.yaml");
    sensor.precision(17);
    sensor << "T_BS:\n  rows: 4\n  cols: 4\n  data: [";
    for (int i = 0; i < 16; ++i) { sensor << T(i / 4, i % 4) << (i < 15 ? ", " : "]\n"); }
    sensor << "resolution: [" << width << ", " << height << "]\ncamera_model: pinhole\n"
           << "intrinsics: [" << of.camera.fx << ", " << of.camera.fy << ", " << of.camera.cx
           << ", " << of.camera.cy << "]\ndistortion_model: radial-tangential\n"
           << "distortion_coefficients: [0, 0, 0, 0]\n";
  }
}

TEST(Maps, ARigOfFourCameras) {
  temp_folder const folder;
  write_four_cameras(folder.path("mapped"), false);
  write_four_cameras(folder.path("later"), true);
  for (char const* camera : {"cam0", "cam1"}) {
    std::string const list = folder.path("later/mav0/" + std::string(camera) + "/data.csv");
    strings lines = lines_of(read_file(list));
    lines.erase(lines.begin() + 1, lines.begin() + 1 + skipped);
    std::ofstream file(list);
    for (std::string const& l : lines) { file << l << "\n"; }
  }
  expect_found(folder.path("mapped"), folder.path("later"), {"--rig", "mixed"});
}

}  // namespace

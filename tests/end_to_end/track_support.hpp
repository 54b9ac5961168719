// SPDX-License-Identifier: Apache-2.0
/// @file Sequences to track, runs of track_sequence and what they wrote, for the tests of this
/// folder.
#pragma once

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <random>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/end_to_end/process.hpp"
#include "tests/support/sequence.hpp"

namespace app_test {

namespace fs = std::filesystem;
using nlohmann::json;
using seq_test::contains;
using seq_test::temp_folder;
using strings = std::vector<std::string>;

constexpr char const* tracker = FT_TRACK_SEQUENCE;
constexpr char const* generator = FT_GENERATE_SEQUENCE;
constexpr int width = 376;
constexpr int height = 240;
constexpr int many = 40;  ///< frames: 2 s, of which the camera stands still in the first
constexpr int few = 6;

// ---- how a run ended

inline strings lines_of(std::string const& text) {
  strings lines;
  std::istringstream stream(text);
  for (std::string line; std::getline(stream, line);) { lines.push_back(line); }
  return lines;
}

/// Exit status 0 and nothing on stderr.
inline testing::AssertionResult succeeded(outcome const& o) {
  if (o.signal == 0 && o.status == 0 && o.err.empty()) { return testing::AssertionSuccess(); }
  return testing::AssertionFailure() << "should have succeeded: " << o;
}

/// One line on stderr that begins with the program's name and names `subject`, and an exit status
/// that says so.
inline testing::AssertionResult complained_of(outcome const& o, std::string const& subject) {
  strings const lines = lines_of(o.err);
  if (o.signal == 0 && o.status >= 1 && o.status <= 125 && lines.size() == 1 &&
      lines[0].rfind("track_sequence: ", 0) == 0 && contains(lines[0], subject)) {
    return testing::AssertionSuccess();
  }
  return testing::AssertionFailure()
         << "should have ended with one line about '" << subject << "': " << o;
}

/// The option parser's message: names `option` and points to --help.
inline testing::AssertionResult refused_option(outcome const& o, std::string const& option) {
  strings const lines = lines_of(o.err);
  if (o.signal == 0 && o.status >= 1 && o.status <= 125 && lines.size() == 2 &&
      contains(lines[0], option) && contains(lines[1], "--help")) {
    return testing::AssertionSuccess();
  }
  return testing::AssertionFailure() << "should have refused '" << option << "': " << o;
}

// ---- sequences

/// A generated sequence, made once in the life of this process.
inline std::string generated(int frames, strings const& options = {}) {
  static std::map<strings, std::unique_ptr<temp_folder>> made;
  strings arguments = options;
  if (options.empty()) {
    arguments = {"--width", std::to_string(width), "--height", std::to_string(height)};
  }
  arguments.insert(arguments.end(), {"--frames", std::to_string(frames)});
  std::unique_ptr<temp_folder>& folder = made[arguments];
  if (!folder) {
    folder = std::make_unique<temp_folder>();
    arguments.insert(arguments.end(), {"--out", folder->path("sequence")});
    outcome const o = run_program(generator, arguments);
    if (o.signal != 0 || o.status != 0) {
      std::ostringstream text;
      text << o;
      folder.reset();
      throw std::runtime_error(text.str());
    }
  }
  return folder->path("sequence");
}

inline seq::image plain(std::uint8_t grey, int w = width, int h = height) {
  seq::image picture;
  picture.width = w;
  picture.height = h;
  picture.pixels.assign(static_cast<std::size_t>(w) * static_cast<std::size_t>(h), grey);
  return picture;
}

inline seq::image noise(unsigned seed) {
  std::mt19937 bits(seed);
  seq::image picture = plain(0);
  for (auto& pixel : picture.pixels) { pixel = static_cast<std::uint8_t>(bits() >> 24); }
  return picture;
}

/// A copy of a generated sequence, to spoil.
class spoilt_sequence {
public:
  explicit spoilt_sequence(int frames, strings const& options = {}) {
    fs::copy(generated(frames, options), path(), fs::copy_options::recursive);
    for (auto const& file : fs::directory_iterator(fs::path(path()) / "mav0/cam0/data")) {
      names_.push_back(file.path().filename().string());
    }
    std::sort(names_.begin(), names_.end());
  }
  std::string path() const { return folder_.path("sequence"); }
  std::string path(std::string const& name) const { return path() + "/mav0/" + name; }
  std::string out() const { return folder_.path("out"); }
  temp_folder const& folder() const { return folder_; }

  int size() const { return static_cast<int>(names_.size()); }
  std::string image(int camera, int frame) const {
    return path("cam" + std::to_string(camera) + "/data/" +
                names_.at(static_cast<std::size_t>(frame)));
  }
  void set_pair(int frame, seq::image const& left, seq::image const& right) const {
    seq::write_png(image(0, frame), left);
    seq::write_png(image(1, frame), right);
  }
  /// Replaces the line of a file under mav0 that begins with `key`.
  void set_line(std::string const& name, std::string const& key, std::string const& line) const {
    strings lines = lines_of(read_file(path(name)));
    auto const at = std::find_if(lines.begin(), lines.end(),
                                 [&](std::string const& l) { return l.rfind(key, 0) == 0; });
    if (at == lines.end()) { throw std::runtime_error(path(name) + " has no line " + key); }
    *at = line;
    std::ofstream file(path(name));
    for (std::string const& l : lines) { file << l << "\n"; }
  }
  /// Leaves the pairs out of the lists for which `lost(frame)` holds, as a camera does that drops
  /// them. Returns how many there are left.
  int drop(std::function<bool(int)> const& lost) const {
    int left = 0;
    for (char const* camera : {"cam0", "cam1"}) {
      std::string const list = path(camera + std::string("/data.csv"));
      strings const lines = lines_of(read_file(list));
      std::ofstream file(list);
      left = 0;
      for (std::size_t i = 0; i < lines.size(); ++i) {  // a line of names goes first
        if (i > 0 && lost(static_cast<int>(i) - 1)) { continue; }
        file << lines[i] << "\n";
        left += static_cast<int>(i > 0);
      }
    }
    return left;
  }

private:
  temp_folder folder_;
  strings names_;
};

/// The pairs of a generated sequence in KITTI odometry layout, `interval_s` apart.
inline void write_kitti(std::string const& from, std::string const& to, double interval_s) {
  auto const source = seq::sequence::open(from);
  for (char const* camera : {"0", "1"}) {
    fs::create_directories(to + "/image_" + camera);
    strings files;
    for (auto const& file : fs::directory_iterator(from + "/mav0/cam" + camera + "/data")) {
      files.push_back(file.path().string());
    }
    std::sort(files.begin(), files.end());
    for (std::size_t i = 0; i < files.size(); ++i) {
      std::string const number = std::to_string(1000000 + i).substr(1);
      fs::copy_file(files[i], to + "/image_" + camera + "/" + number + ".png");
    }
  }
  std::ofstream times(to + "/times.txt");
  seq::trajectory truth;
  for (int i = 0; i < source.size(); ++i) {
    auto const pose = seq::interpolate(source.ground_truth(), source.time_ns(i));
    truth.push_back({std::llround(i * interval_s * 1e9), *pose});
    times << i * interval_s << "\n";
  }
  seq::write_tum(to + "/groundtruth.txt", truth);
  auto const& c = source.rig().left;
  std::ofstream calib(to + "/calib.txt");
  for (int camera = 0; camera < 2; ++camera) {
    calib.precision(12);
    calib << "P" << camera << ": " << c.fx << " 0 " << c.cx << " "
          << (camera == 0 ? 0 : -c.fx * source.rig().baseline()) << " 0 " << c.fy << " " << c.cy
          << " 0 0 0 1 0\n";
  }
}

// ---- runs and their results

/// Runs the tracker on the host, with one thread where `options` do not say more.
inline outcome track(std::string const& sequence, std::string const& out,
                     strings const& options = {}, meanwhile const& doing = {}) {
  strings arguments{"--sequence", sequence, "--out", out};
  auto const add = [&](std::string const& option, std::string const& value) {
    if (std::find(options.begin(), options.end(), option) == options.end()) {
      arguments.insert(arguments.end(), {option, value});
    }
  };
  add("--backend", "host");
  add("--threads", "1");
  arguments.insert(arguments.end(), options.begin(), options.end());
  return run_program(tracker, arguments, std::chrono::seconds(300), doing);
}

using table = std::vector<std::map<std::string, std::string>>;

struct results {
  json summary;
  seq::trajectory path;
  table times;  ///< rows of times.csv

  int number(char const* key) const { return summary.at(key).get<int>(); }
  bool tracked(int row) const {
    return times.at(static_cast<std::size_t>(row)).at("tracked") == "1";
  }
};

inline strings split(std::string const& line, char separator) {
  strings fields;
  std::istringstream stream(line + separator);
  for (std::string field; std::getline(stream, field, separator);) { fields.push_back(field); }
  return fields;
}

inline table read_times(std::string const& path) {
  strings const lines = lines_of(read_file(path));
  table rows;
  if (lines.empty()) { return rows; }
  strings const head = split(lines[0], ',');
  for (std::size_t i = 1; i < lines.size(); ++i) {
    strings const fields = split(lines[i], ',');
    EXPECT_EQ(fields.size(), head.size()) << path << " line " << i + 1;
    rows.emplace_back();
    for (std::size_t f = 0; f < std::min(fields.size(), head.size()); ++f) {
      rows.back()[head[f]] = fields[f];
    }
  }
  return rows;
}

/// What a page would fetch from elsewhere; empty where all it refers to is in it.
inline strings outside_references(std::string const& html) {
  strings found;
  auto const at_each = [&](std::string const& text, auto const& look) {
    for (std::size_t at = html.find(text); at != std::string::npos; at = html.find(text, at + 1)) {
      if (!look(at)) { found.push_back(html.substr(at, 60)); }
    }
  };
  for (char const* forbidden :
       {"@import", "<link", "<iframe", "<object", "<embed", "<base", "XMLHttpRequest", "fetch(",
        "import(", "sendBeacon", "\"//", "'//", "srcset="}) {
    at_each(forbidden, [](std::size_t) { return false; });
  }
  for (std::string const reference : {"src=", "href=", "url(", "poster=", "action="}) {
    at_each(reference, [&](std::size_t at) {
      std::size_t const value = html.find_first_not_of("\"' ", at + reference.size());
      return value != std::string::npos &&
             (html.compare(value, 5, "data:") == 0 || html[value] == '#');
    });
  }
  for (char const* scheme : {"http:", "https:", "file:", "ftp:"}) {
    at_each(scheme, [&](std::size_t at) {  // a name space is not fetched
      std::size_t const before = at < 20 ? 0 : at - 20;
      return contains(html.substr(before, at - before), "xmlns");
    });
  }
  return found;
}

/// The run was stopped early, which it says in one line that names `subject`.
/// @param frame the first one that was not tracked
inline testing::AssertionResult stopped_at(outcome const& o, int frame,
                                           std::string const& subject) {
  std::string const words = "stopped at frame " + std::to_string(frame) + ": ";
  if (o.status == 3 && complained_of(o, words) && complained_of(o, subject)) {
    return testing::AssertionSuccess();
  }
  return testing::AssertionFailure()
         << "should have stopped at frame " << frame << " because of '" << subject << "': " << o;
}

/// The files that every run leaves over `pairs` stereo pairs, with everything that must agree
/// checked.
inline results read_results(std::string const& out, int pairs) {
  results r;
  r.summary = json::parse(read_file(out + "/summary.json"));
  json const& s = r.summary;
  for (char const* key : {"frames", "tracked", "lost", "dropped", "keyframes", "map_points"}) {
    EXPECT_TRUE(s.contains(key) && s[key].is_number_integer() && s[key] >= 0) << key;
  }
  EXPECT_TRUE(s.contains("path_m") && s["path_m"].is_number());
  for (char const* key : {"ate_rmse_m", "rpe_rmse_m"}) {
    EXPECT_TRUE(s.contains(key) && (s[key].is_number() || s[key].is_null())) << key;
  }
  EXPECT_EQ(s.value("backend", ""), "host");
  EXPECT_TRUE(s.contains("stages") && s["stages"].contains("total"));
  json const stages = s.value("stages", json::object());
  for (auto const& [name, stage] : stages.items()) {
    for (char const* key : {"mean_ms", "std_ms", "p50_ms", "p99_ms", "max_ms"}) {
      EXPECT_TRUE(stage.contains(key) && stage[key].is_number() && stage[key] >= 0)
          << name << " " << key;
    }
    EXPECT_LE(stage.at("p50_ms"), stage.at("p99_ms")) << name;
    EXPECT_LE(stage.at("p99_ms"), stage.at("max_ms")) << name;
    EXPECT_LE(stage.at("mean_ms"), stage.at("max_ms")) << name;
  }
  EXPECT_EQ(r.number("frames") + r.number("dropped"), pairs);
  EXPECT_EQ(r.number("tracked") + r.number("lost"), r.number("frames"));

  int poses = 0;
  for (std::string const& line : lines_of(read_file(out + "/trajectory.txt"))) {
    if (!line.empty() && line[0] != '#') { ++poses; }
  }
  EXPECT_EQ(poses, r.number("tracked"));
  r.path = seq::read_tum(out + "/trajectory.txt");
  EXPECT_EQ(static_cast<int>(r.path.size()), poses);
  if (!r.path.empty()) {
    Eigen::Matrix4d const first = r.path.front().T_world_camera.matrix();
    EXPECT_TRUE(first.isIdentity(1e-9)) << "the world is the first camera\n" << first;
  }

  r.times = read_times(out + "/times.csv");
  EXPECT_EQ(static_cast<int>(r.times.size()), r.number("frames"));
  std::size_t pose = 0;
  int keyframes = 0;
  for (auto const& row : r.times) {
    keyframes += row.at("keyframe") == "1" ? 1 : 0;
    if (row.at("tracked") != "1") { continue; }
    if (pose >= r.path.size()) {
      ADD_FAILURE() << "more tracked rows in times.csv than poses";
      break;
    }
    std::string stamp = std::to_string(r.path[pose].time_ns);
    if (stamp.size() < 10) { stamp.insert(0, 10 - stamp.size(), '0'); }
    stamp.insert(stamp.size() - 9, ".");
    EXPECT_EQ(row.at("time_s"), stamp);
    ++pose;
  }
  EXPECT_EQ(pose, r.path.size());
  EXPECT_EQ(keyframes, r.number("keyframes"));

  std::string const html = read_file(out + "/report.html");
  EXPECT_GT(html.size(), 10'000u);
  EXPECT_TRUE(contains(html, "</html>"));
  EXPECT_EQ(outside_references(html), strings{});
  return r;
}

/// Largest distance between estimated and true positions, both seen from the first pose: no
/// alignment hides a drift.
inline double largest_drift(seq::trajectory const& estimate, seq::trajectory const& truth) {
  auto const origin = seq::interpolate(truth, estimate.at(0).time_ns);
  double largest = 0;
  for (auto const& pose : estimate) {
    auto const at = seq::interpolate(truth, pose.time_ns);
    if (!origin || !at) {
      ADD_FAILURE() << "no ground truth at " << pose.time_ns;
      continue;
    }
    Eigen::Vector3d const expected = (origin->inverse() * *at).translation();
    largest = std::max(largest, (pose.T_world_camera.translation() - expected).norm());
  }
  return largest;
}

}  // namespace app_test

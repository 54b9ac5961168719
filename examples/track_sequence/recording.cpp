// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/recording.hpp"

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <system_error>

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/odometry_input.hpp"
#include "examples/track_sequence/setup.hpp"

namespace app {
namespace {

using json = nlohmann::ordered_json;

/// A 3 x 4 matrix, row-major.
std::array<double, 12> twelve(ft::rigid<double> const& T) {
  std::array<double, 12> m{};
  double const t[3] = {T.t.x, T.t.y, T.t.z};
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) { m[4 * r + c] = T.R.m[3 * r + c]; }
    m[4 * r + 3] = t[r];
  }
  return m;
}

/// fx, fy, cx, cy and what follows of the model.
json camera_of(seq::camera_intrinsics const& c) {
  json values = {c.fx, c.fy, c.cx, c.cy};
  for (double const k : c.distortion) { values.push_back(k); }
  return values;
}

char const* model_of(seq::camera_intrinsics const& c) {
  switch (c.model) {
    case seq::lens::radial_tangential:
      return "RadTan";
    case seq::lens::kannala_brandt:
      return "KannalaBrandt";
    case seq::lens::double_sphere:
      return "DoubleSphere";
    default:
      return "Pinhole";
  }
}

json truth_of(seq::sequence const& sequence) {
  if (sequence.ground_truth().empty()) { return nullptr; }
  json times = json::array();
  json poses = json::array();
  for (auto const& pose : sequence.ground_truth()) {
    times.push_back(pose.time_ns);
    poses.push_back(twelve(seq::odometry_pose(pose.T_world_camera)));
  }
  return {{"time_ns", times},
          {"T_world_camera", poses},
          {"orientation", sequence.ground_truth_has_orientation()}};
}

/// Shorter in the file.
double rounded(float v) { return std::round(1000.0 * static_cast<double>(v)) / 1000.0; }

/// Pieces of the path, each of one map and one run, and pairs of places.
json corrected_of(corrected_keyframes const& of) {
  auto const place = [](ft::placed_keyframe const& k) {
    ft::vec3<double> const& t = k.T_world_camera.t;
    return json{t.x, t.y, t.z};
  };
  json path = json::array();
  for (std::size_t i = 0; i < of.keyframes.size(); ++i) {
    ft::placed_keyframe const& k = of.keyframes[i];
    ft::placed_keyframe const* const before = i > 0 ? &of.keyframes[i - 1] : nullptr;
    if (before == nullptr || before->map != k.map || before->loaded != k.loaded) {
      path.push_back(json::array());
    }
    path.back().push_back(place(k));
  }
  json loops = json::array();
  for (ft::closed_loop const& l : of.loops) {
    loops.push_back({place(of.keyframes[static_cast<std::size_t>(l.from)]),
                     place(of.keyframes[static_cast<std::size_t>(l.to)])});
  }
  return {{"path", path}, {"loops", loops}};
}

std::string image_name(int index) {
  char name[32];
  std::snprintf(name, sizeof name, "left/%06d.png", index);
  return name;
}

}  // namespace

recording::recording(std::string const& folder, seq::sequence const& sequence,
                     std::vector<std::string> const& stages)
    : folder_(folder) {
  std::error_code failed;
  std::filesystem::create_directories(folder + "/left", failed);
  if (failed) { throw seq::error("--record " + folder + ": " + failed.message()); }
  lines_.open(folder + "/recording.jsonl");
  auto const& left = sequence.rig().left;
  write_line(json{{"ft_recording", 1},
                  {"sequence", sequence.name()},
                  {"width", left.width},
                  {"height", left.height},
                  {"camera", camera_of(left)},
                  {"model", model_of(left)},
                  {"stages", stages},
                  {"truth", truth_of(sequence)}}
                 .dump());
}

void recording::add(seq::frame_record const& frame, ft::rigid<double> const& T_wc,
                    seq::image const& left, std::vector<seen_keypoint> const& keypoints,
                    std::optional<corrected_keyframes> const& corrected) {
  std::string const image = image_name(frame.index);
  seq::write_png(folder_ + "/" + image, left);
  json line = {{"frame", frame.index},
               {"time_ns", frame.time_ns},
               {"image", image},
               {"tracked", frame.tracked},
               {"keyframe", frame.keyframe},
               {"T_world_camera", twelve(T_wc)},
               {"counts",
                {{"keypoints", frame.keypoints},
                 {"with depth", frame.stereo_matches},
                 {"inliers", frame.inliers},
                 {"local map", frame.local_points}}},
               {"stage_ms", frame.stage_ms}};
  for (char const* name : {"x", "y", "depth", "point", "matched"}) { line[name] = json::array(); }
  for (seen_keypoint const& k : keypoints) {
    line["x"].push_back(rounded(k.x));
    line["y"].push_back(rounded(k.y));
    line["depth"].push_back(rounded(k.depth));
    line["point"].push_back(k.point);
    line["matched"].push_back(k.matched ? 1 : 0);
  }
  if (corrected) { line["corrected"] = corrected_of(*corrected); }
  write_line(line.dump());
}

void recording::write_line(std::string const& line) {
  lines_ << line << '\n';
  lines_.flush();
  if (!lines_) { throw seq::error(folder_ + "/recording.jsonl: cannot be written"); }
}

}  // namespace app

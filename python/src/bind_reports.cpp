// SPDX-License-Identifier: Apache-2.0
// What track_sequence writes, of a run in Python.
#include <nanobind/stl/map.h>
#include <nanobind/stl/vector.h>

#include <iostream>

#include "examples/sequence/reader.hpp"
#include "examples/sequence/report.hpp"
#include "examples/track_sequence/options.hpp"
#include "examples/track_sequence/outputs.hpp"
#include "examples/track_sequence/processor_name.hpp"
#include "ft/pipelines/map_files.hpp"
#include "python/src/trajectories.hpp"

namespace ftpy {
namespace {

app::arguments arguments_of(nb::handle out, std::string const& frame, std::string const& poses) {
  app::arguments a;
  a.out = nb::cast<std::string>(nb::str(out));
  a.frame = frame;
  a.poses = poses;
  return a;
}

/// @param given number of the frame, time stamp, whether it has a pose, times of stages, tracking
seq::frame_record record_of(nb::handle given) {
  auto const& said = nb::cast<tracking const&>(given[4]);
  ft::tracking const& t = said.of;
  seq::frame_record r;
  r.index = nb::cast<int>(given[0]);
  r.time_ns = nb::cast<std::int64_t>(given[1]);
  r.tracked = nb::cast<bool>(given[2]);
  r.stage_ms = nb::cast<std::vector<double>>(given[3]);
  r.keyframe = t.keyframe;
  r.metric = t.metric;
  r.keypoints = t.keypoints;
  r.stereo_matches = t.stereo_points;
  r.inliers = t.inliers;
  r.local_points = t.local_points;
  r.images_to_pose_ms = r.stage_ms.back();  // nothing is given ahead
  r.reason = reason_of(said);
  r.why = said.why.text;
  r.imu_warnings = said.imu_warnings;
  for (ft::tracking_notice const& notice : said.warnings) {
    if (notice.warning == ft::tracking_warning::imu) { continue; }  // with sentences of their own
    r.warnings.emplace_back(ft::name_of(notice.warning), notice.text);
  }
  r.map_id = t.map_id;
  r.map_begun = t.map_begun;
  if (said.imu) {
    r.imu_state = ft::name_of(said.imu->state);
    if (said.imu->state != ft::imu_state::used) { r.imu_reason = said.imu->reason; }
    r.imu_why = said.imu->text;
    if (t.imu.clock.known) { r.imu_clock_offset_s = t.imu.clock.offset_s; }
    ft::imu_misalignment const& off = t.imu.misalignment;
    if (off.known) { r.imu_turn = Eigen::Vector3d(off.turn.x, off.turn.y, off.turn.z); }
  }
  for (int row = 0; r.tracked && row < 6; ++row) {  // the upper triangle
    double const* const begin = t.covariance + 6 * row;
    r.covariance.insert(r.covariance.end(), begin + row, begin + 6);
  }
  auto const vector = [](auto const& v) {
    auto const wide = v.template cast<double>();
    return Eigen::Vector3d(wide.x, wide.y, wide.z);
  };
  if (t.imu.known) {
    r.imu = seq::imu_record{t.imu.optimized, vector(t.imu.velocity), vector(t.imu.bias.gyro),
                            vector(t.imu.bias.accel), vector(t.imu.gravity)};
  }
  return r;
}

/// @param given number of the frame, image, columns of keypoints
seq::sample_frame sample_of(nb::handle given) {
  arrays kept;
  image const picture = kept.gray(given[1], "the image of a sample");
  seq::sample_frame s;
  s.index = nb::cast<int>(given[0]);
  s.picture.width = picture.width;
  s.picture.height = picture.height;
  for (int y = 0; y < picture.height; ++y) {
    std::uint8_t const* const row = picture.data + static_cast<std::ptrdiff_t>(y) * picture.stride;
    s.picture.pixels.insert(s.picture.pixels.end(), row, row + picture.width);
  }
  for (nb::handle const k : given[2]) {
    auto const at = [&](int i) { return nb::cast<float>(k[i]); };
    s.keypoints.push_back(
        {at(0), at(1), at(2), nb::cast<int>(k[3]), at(4), nb::cast<bool>(k[5]), at(6), at(7)});
  }
  return s;
}

seq::stamped_pose stamped_of(nb::handle time_ns, nb::handle T_world_camera) {
  arrays kept;
  double const* const m = kept.doubles(T_world_camera, "a pose of a loop", {4, 4});
  seq::stamped_pose p;
  p.time_ns = nb::cast<std::int64_t>(time_ns);
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 4; ++c) { p.T_world_camera.matrix()(r, c) = m[4 * r + c]; }
  }
  return p;
}

/// @param given time stamp and pose of both keyframes, inliers, whether the first one was loaded
seq::loop_edge edge_of(nb::handle given) {
  return {stamped_of(given[0], given[1]), stamped_of(given[2], given[3]), nb::cast<int>(given[4]),
          nb::cast<bool>(given[5])};
}

seq::run_report report_of(seq::sequence const& sequence, nb::handle run) {
  auto const text = [&](char const* name) { return nb::cast<std::string>(run[name]); };
  auto const count = [&](char const* name) { return nb::cast<int>(run[name]); };
  auto const flag = [&](char const* name) { return nb::cast<bool>(run[name]); };
  seq::run_report r;
  r.title = "Tracking of " + sequence.name();
  r.sequence = sequence.name();
  r.backend = text("backend");
  r.device = r.backend == "host" ? app::processor_name() : ft::gpu_names().at(0);
  r.options = nb::cast<std::map<std::string, std::string>>(run["options"]);
  r.version = text("version");
  r.command = seq::command_line(nb::cast<std::vector<std::string>>(run["command"]));
  r.date = text("date");
  r.threads = count("threads");
  r.image_width = count("width");
  r.image_height = count("height");
  r.stages = nb::cast<std::vector<std::string>>(run["stages"]);
  for (nb::handle const h : run["records"]) { r.records.push_back(record_of(h)); }
  for (seq::frame_record const& record : r.records) { r.tracked += record.tracked ? 1 : 0; }
  r.frames = static_cast<int>(r.records.size());
  r.lost = r.frames - r.tracked;
  r.keyframes = count("keyframes");
  r.map_points = count("map_points");
  r.maps = count("maps");
  r.warnings = nb::cast<std::vector<std::string>>(run["warnings"]);
  r.calibration = nb::cast<std::vector<std::string>>(run["calibration"]);
  r.one_camera = flag("one_camera");
  r.depth_images = flag("depth_images");
  r.with_imu = flag("with_imu");
  r.metric = flag("metric");
  r.estimate = trajectory_of(run["time_ns"], run["poses"], "the estimate");
  nb::object const loops = run["loops"];
  if (!loops.is_none()) {
    r.loops.emplace();
    r.loops->closed = nb::cast<int>(loops["closed"]);
    r.loops->corrections = nb::cast<int>(loops["corrections"]);
    r.loops->maps = nb::cast<int>(loops["maps"]);
    r.loops->tracked = trajectory_of(run["time_ns"], loops["tracked"], "the estimate");
    r.loops->online = trajectory_of(loops["online_time_ns"], loops["online"], "the estimate");
    for (nb::handle const h : loops["edges"]) { r.loops->edges.push_back(edge_of(h)); }
  }
  nb::object const map = run["loaded_map"];
  if (!map.is_none()) { r.loaded_map = {nb::cast<std::string>(map[0]), nb::cast<int>(map[1])}; }
  for (nb::handle const h : run["samples"]) { r.samples.push_back(sample_of(h)); }
  for (nb::handle const p : run["cloud"]) {
    auto const at = [&](int i) { return nb::cast<float>(p[i]); };
    r.cloud.emplace_back(at(0), at(1), at(2));
  }
  nb::object const stopped = run["stopped_at"];
  if (!stopped.is_none()) {
    r.stopped_at = nb::cast<int>(stopped);
    r.stopped_by = text("stopped_by");
  }
  r.wall_s = nb::cast<double>(run["wall_s"]);
  return r;
}

/// @param points,normals (n, 3)
ft::odometry_map map_of(nb::handle points, nb::handle normals) {
  ft::odometry_map map;
  auto const vector = [](nb::handle v) {
    return ft::vec3<float>{nb::cast<float>(v[0]), nb::cast<float>(v[1]), nb::cast<float>(v[2])};
  };
  std::size_t const n = nb::len(points);
  for (std::size_t i = 0; i < n; ++i) {
    ft::downloaded_point p{};
    p.position = vector(points[i]);
    p.normal = vector(normals[i]);
    map.points.push_back(p);
  }
  return map;
}

ft::pose moved(Eigen::Isometry3d const& T) {
  ft::pose p;
  for (int r = 0; r < 3; ++r) {
    for (int c = 0; c < 3; ++c) { p.R.m[3 * r + c] = static_cast<float>(T.matrix()(r, c)); }
  }
  p.t = {static_cast<float>(T.matrix()(0, 3)), static_cast<float>(T.matrix()(1, 3)),
         static_cast<float>(T.matrix()(2, 3))};
  return p;
}

}  // namespace

void bind_reports(nb::module_& m) {
  m.def(
      "make_output_folder",
      [](nb::handle out, std::string const& recording) {
        app::arguments a = arguments_of(out, "camera", "tum");
        a.sequence = recording;
        app::make_output_folder(a);
      },
      nb::arg("out"), nb::arg("recording"),
      "Raises RuntimeError for a folder that cannot be written, or that is a recording's.");
  m.def(
      "write_run",
      [](seq::sequence const& sequence, nb::handle out, std::string const& frame,
         std::string const& poses, nb::handle run) {
        seq::run_report report = report_of(sequence, run);
        ft::odometry_map map = map_of(run["map_position"], run["map_normal"]);
        auto const write = [&](std::ostream& to, Eigen::Isometry3d const& T_file_world) {
          ft::pose const T = moved(T_file_world);
          for (auto& p : map.points) {
            p.position = T * p.position;
            p.normal = T.R * p.normal;
          }
          ft::write_ply(to, map);
        };
        app::finish(arguments_of(out, frame, poses), sequence, write, report);
        std::cout << std::flush;
      },
      nb::arg("sequence"), nb::arg("out"), nb::arg("frame"), nb::arg("poses"), nb::arg("run"),
      "Writes the files of a run, and prints its summary.");
}

}  // namespace ftpy

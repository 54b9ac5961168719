// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/outputs.hpp"

#include <cerrno>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>
#include <string>
#include <system_error>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/warnings.hpp"

namespace app {
namespace {

namespace fs = std::filesystem;

/// Calls change(pose) for all poses that were estimated.
template <typename Change>
void each_pose(seq::run_report& report, Change const& change) {
  for (auto& pose : report.estimate) { change(pose); }
  if (!report.loops) { return; }
  for (auto& pose : report.loops->tracked) { change(pose); }
  for (auto& pose : report.loops->online) { change(pose); }
  for (auto& edge : report.loops->edges) {
    change(edge.from);
    change(edge.to);
  }
}

/// The estimate and the truth become poses of the body; the world becomes the first one's body.
void move_to_body(seq::sequence const& sequence, seq::run_report& report) {
  Eigen::Isometry3d const T_body_camera = sequence.rig().T_body_left;
  each_pose(report, [&](seq::stamped_pose& pose) {
    pose.T_world_camera = T_body_camera * pose.T_world_camera * T_body_camera.inverse();
  });
  for (auto& point : report.cloud) { point = T_body_camera.cast<float>() * point; }
  if (sequence.ground_truth_has_orientation()) {
    report.truth = seq::poses_of(report.truth, T_body_camera.inverse());
  }
}

/// The times of the processed frames.
seq::trajectory frame_times(seq::run_report const& report) {
  seq::trajectory times;
  for (auto const& record : report.records) { times.push_back({record.time_ns, {}}); }
  return times;
}

/// A pose for each frame of the sequence up to the last processed one. KITTI's format has no gaps:
/// a frame without a pose has that of the frame before it, and the identity before the first pose.
seq::trajectory without_gaps(seq::sequence const& sequence, seq::run_report const& report) {
  seq::trajectory all;
  auto next = report.estimate.begin();
  seq::stamped_pose last;
  int const frames = report.records.empty() ? 0 : report.records.back().index + 1;
  for (int i = 0; i < frames; ++i) {
    if (next != report.estimate.end() && next->time_ns == sequence.time_ns(i)) { last = *next++; }
    all.push_back({sequence.time_ns(i), last.T_world_camera});
  }
  return all;
}

/// Writes the poses. Files of an older run that this one does not have are removed.
void write_poses(arguments const& a, seq::sequence const& sequence, seq::run_report const& report) {
  seq::write_tum(a.out + "/trajectory.txt", report.estimate, a.frame);
  if (report.loops) {
    seq::write_tum(a.out + "/trajectory_online.txt", report.loops->online, a.frame);
  } else {
    fs::remove(a.out + "/trajectory_online.txt");
  }
  std::string const truth_file = a.out + "/groundtruth.txt";
  seq::trajectory const truth = seq::at_times_of(frame_times(report), report.truth);
  if (truth.empty()) {
    fs::remove(truth_file);
  } else {
    seq::write_tum(truth_file, truth, a.frame);
  }
  if (a.poses == "kitti") {
    seq::write_kitti_poses(a.out + "/poses.txt", without_gaps(sequence, report));
  } else {
    fs::remove(a.out + "/poses.txt");
  }
}

/// Writes the points of the map, in the world of the poses.
void write_map(arguments const& a, seq::sequence const& sequence, map_writer const& map) {
  std::string const path = a.out + "/map.ply";
  std::ostringstream text;
  map(text, a.frame == "body" ? sequence.rig().T_body_left : Eigen::Isometry3d::Identity());
  std::ofstream out(path, std::ios::binary);
  out << text.str();
  out.flush();
  if (!out) { throw seq::error(path + ": cannot be written"); }
}

/// @throws seq::error where a file of the run could not be written: before the run, not after it
void require_writable(std::string const& folder) {
  for (char const* name : {"trajectory.txt", "trajectory_online.txt", "groundtruth.txt",
                           "poses.txt", "map.ply", "times.csv", "summary.json", "report.html"}) {
    fs::path const file = fs::path(folder) / name;
    if (!fs::exists(file)) { continue; }
    errno = 0;
    if (fs::is_directory(file) || !std::ofstream(file, std::ios::app)) {
      throw seq::error("--out " + folder + ": " + name + " is there and cannot be written" +
                       (errno != 0 ? std::string(": ") + std::strerror(errno) : std::string()));
    }
  }
  fs::path const probe = fs::path(folder) / ".written";
  errno = 0;
  std::ofstream out(probe);
  out << "a file to see whether the folder can be written\n";
  out.close();
  bool const written = static_cast<bool>(out);
  int const reason = errno;
  std::error_code ignored;
  fs::remove(probe, ignored);
  if (!written) {
    throw seq::error("--out " + folder + ": cannot be written" +
                     (reason != 0 ? std::string(": ") + std::strerror(reason) : std::string()));
  }
}

std::string partial(std::string const& path) { return path + ".partial"; }

/// Before the run, too. A device would be replaced by the file: --save-map /dev/null.
void require_map_writable(std::string const& path) {
  if (fs::exists(path) && !fs::is_directory(path) && !fs::is_regular_file(path)) {
    throw seq::error("--save-map " + path + ": cannot be written: not a plain file");
  }
  errno = 0;
  bool const written = !fs::is_directory(path) && std::ofstream(partial(path), std::ios::app);
  int const reason = fs::is_directory(path) ? EISDIR : errno;
  std::error_code ignored;
  fs::remove(partial(path), ignored);
  if (!written) {
    throw seq::error("--save-map " + path + ": cannot be written: " + std::strerror(reason));
  }
}

/// What shows that a folder is that of a recording; empty where nothing does.
std::string part_of_recording(fs::path const& folder) {
  for (char const* part : {"mav0", "cam0", "image_0", "image_2", "image_00", "image_02", "rgb.txt",
                           "associations.txt", "color.txt"}) {
    if (fs::exists(folder / part)) { return part; }
  }
  std::error_code failure;
  for (fs::directory_iterator it(folder, failure), end; !failure && it != end;
       it.increment(failure)) {
    std::string const name = it->path().filename().string();
    bool const colour = it->path().stem().extension() == ".color";  // frame-000000.color.png
    if (name.compare(0, 6, "frame-") == 0 && colour) { return name; }
  }
  return {};
}

}  // namespace

void make_output_folder(arguments const& a) {
  std::error_code failed;
  std::string part = part_of_recording(a.out);
  if (part.empty() && fs::equivalent(a.out, a.sequence, failed)) { part = "the images"; }
  if (!part.empty()) {
    throw seq::error("--out " + a.out + ": is the folder of a sequence (it has " + part +
                     "), whose ground truth could be overwritten; accepted is another folder");
  }
  fs::create_directories(a.out, failed);
  if (failed) { throw seq::error("--out " + a.out + ": cannot be made: " + failed.message()); }
  require_writable(a.out);
  if (!a.save_map.empty()) { require_map_writable(a.save_map); }
}

void save_map(std::string const& path, ft::any_odometry const& odometry) {
  std::error_code failed;
  try {
    std::ofstream file(partial(path), std::ios::binary);
    odometry.save_map(file);
    file.close();
    if (!file) { throw seq::error("cannot be written"); }
    fs::rename(partial(path), path);
  } catch (std::exception const& e) {
    fs::remove(partial(path), failed);
    throw seq::error("--save-map " + path + ": " + e.what());
  }
  std::cout << "map       saved to " << path << ", " << (fs::file_size(path) + 500000) / 1000000
            << " MB\n";
}

void finish(arguments const& a, seq::sequence const& sequence, map_writer const& map,
            seq::run_report& report) {
  report.truth = sequence.ground_truth();
  report.frame = a.frame;
  report.fit = seq::fit_scale(report.estimate, report.truth);
  if (!report.metric && report.fit) { report.scale = report.fit->scale; }
  if (!report.metric || (report.fit && !report.fit->same_shape())) { report.fit.reset(); }
  if (a.frame == "body") { move_to_body(sequence, report); }
  write_poses(a, sequence, report);
  if (report.scale) {
    each_pose(report,
              [&](seq::stamped_pose& p) { p.T_world_camera.translation() *= *report.scale; });
  }
  report.error =
      seq::evaluate(report.estimate, report.truth, sequence.ground_truth_has_orientation());
  if (report.loops) {
    bool const oriented = sequence.ground_truth_has_orientation();
    report.loops->online_ate_m =
        seq::evaluate(report.loops->online, report.truth, oriented).ate_rmse_m;
  }
  report.unpaired_left = sequence.unpaired().left;
  report.unpaired_right = sequence.unpaired().right;
  // A caller that has unpacked a recording has told what it was, in its own names.
  if (report.warnings.empty()) { report.warnings = sequence.warnings(); }
  for (std::string const& warning : seq::warnings_of(report)) {
    report.warnings.push_back(warning);
  }
  write_map(a, sequence, map);
  seq::write_times_csv(a.out + "/times.csv", report);
  seq::write_summary_json(a.out + "/summary.json", report);
  seq::write_html(a.out + "/report.html", report);
  seq::print_summary(std::cout, report);
  std::cout << "report    " << fs::absolute(a.out + "/report.html").string() << "\n";
}

}  // namespace app

// SPDX-License-Identifier: Apache-2.0
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <string>
#include <vector>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/table.hpp"
#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/evaluation.hpp"

namespace seq::detail {
namespace {

constexpr std::int64_t finest_step_ns = 50'000;

/// EuRoC state_groundtruth_estimate0 and TUM-VI mocap0: time, position, quaternion w x y z; further
/// columns are ignored.
trajectory read_euroc_truth(std::string const& path, std::vector<std::string>& warnings) {
  trajectory poses;
  stamp_column stamps(path, finest_step_ns);
  table const table = read_table(path, 8, "time stamp, position, quaternion w x y z", warnings);
  for (table_row const& row : table.rows) {
    if (is_no_pose(row.fields.data() + 1)) { continue; }
    stamped_pose pose;
    pose.T_world_camera =
        pose_of_fields(row.fields.data() + 1, quaternion_order::w_first, path, row.line);
    stamps.add(row.fields[0], row.line);
    poses.push_back(pose);
  }
  say_no_poses(path, table.rows.size() - poses.size(), table.rows.size(), warnings);
  std::vector<std::int64_t> const times = stamps.times_ns(warnings);
  trajectory taken;
  for (std::size_t const i : ordered_lines(times, disordered::sorted, path, "poses", warnings)) {
    taken.push_back({times[i], poses[i].T_world_camera});
  }
  return taken;
}

/// A pose of 12 numbers, 3x4 row-major. @throws seq::error naming file and line
Eigen::Isometry3d pose_of_rows(double const* values, std::string const& path, int line) {
  Eigen::Map<Eigen::Matrix<double, 3, 4, Eigen::RowMajor> const> const m(values);
  Eigen::Matrix3d const R = m.leftCols<3>();
  double const residual = (R * R.transpose() - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff();
  if (!(residual <= 0.02) || !(R.determinant() > 0)) {
    fail_at(path, line,
            "not a rotation: |R R^T - I| = " + to_text(residual) + ", at most 0.02 allowed");
  }
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.linear() = Eigen::Quaterniond(R).normalized().toRotationMatrix();
  pose.translation() = m.col(3);
  return pose;
}

/// KITTI poses.txt: 12 numbers a frame, 3x4 row-major; one line for each of `times`.
trajectory read_kitti_poses(std::string const& path, std::vector<std::int64_t> const& times) {
  trajectory poses;
  for (text_line const& line : read_lines(path)) {
    if (is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> const words = split(line.text, " \t", true);
    if (words.size() != 12) {
      fail_at(path, line.number, std::to_string(words.size()) + " numbers, must have 12");
    }
    stamped_pose pose;
    if (poses.size() < times.size()) { pose.time_ns = times[poses.size()]; }
    double m[12];
    for (std::size_t i = 0; i < 12; ++i) { m[i] = finite_number(words[i], path, line.number); }
    pose.T_world_camera = pose_of_rows(m, path, line.number);
    poses.push_back(pose);
  }
  if (poses.size() != times.size()) {
    throw error(path + ": " + std::to_string(poses.size()) + " poses, must have one for each of " +
                std::to_string(times.size()) + " frames");
  }
  // Lines whose times are doubled are counted where the times are read.
  std::vector<std::string> said_already;
  trajectory taken;
  for (std::size_t const i :
       ordered_lines(times, disordered::left_out, path, "poses", said_already)) {
    taken.push_back(poses[i]);
  }
  return taken;
}

/// 7-Scenes: a file a frame, 4x4 row-major, camera to world. Frames whose tracking had failed have
/// numbers that are not finite, and are left out.
trajectory read_pose_files(std::vector<listed_image> const& files,
                           std::vector<std::string>& warnings) {
  trajectory poses;
  std::size_t failed = 0;
  for (listed_image const& file : files) {
    std::vector<double> values;
    int last = 1;
    for (text_line const& line : read_lines(file.file)) {
      for (std::string const& word : split(line.text, " \t", true)) {
        double value = 0;
        if (!to_number(word, value)) {
          fail_at(file.file, line.number, "'" + word + "' is not a number");
        }
        values.push_back(value);
        last = line.number;
      }
    }
    if (values.size() != 16) {
      throw error(file.file + ": " + std::to_string(values.size()) +
                  " numbers, must have 16: a 4x4 matrix, camera to world, metres");
    }
    if (!std::all_of(values.begin(), values.end(), [](double v) { return std::isfinite(v); })) {
      ++failed;
      continue;
    }
    Eigen::Map<Eigen::RowVector4d const> const row(values.data() + 12);
    double const off = (row - Eigen::RowVector4d::Unit(3)).cwiseAbs().maxCoeff();
    if (!(off <= 1e-6)) {
      fail_at(file.file, last,
              "the fourth row is not 0 0 0 1: accepted is a 4x4 matrix, camera to world, metres, "
              "row by row");
    }
    poses.push_back({file.time_ns, pose_of_rows(values.data(), file.file, last)});
  }
  if (failed > 0) {
    warnings.push_back("ground truth: " + std::to_string(failed) + " of " +
                       std::to_string(files.size()) +
                       " poses left out, whose numbers are not finite");
  }
  return poses;
}

/// Those of a file in TUM format, whose stamps count frames where those of the images do.
trajectory read_tum_poses(std::string const& path, layout_of_files const& layout,
                          std::vector<std::string>& warnings) {
  trajectory poses = read_tum(path, &warnings);
  if (layout.name != "tum" || layout.rate == 0) { return poses; }
  for (stamped_pose& pose : poses) {
    pose.time_ns = time_of_frame(1e-9 * static_cast<double>(pose.time_ns), layout.rate, path);
  }
  return poses;
}

bool any_rotation(trajectory const& poses) {
  return std::any_of(poses.begin(), poses.end(), [](stamped_pose const& pose) {
    Eigen::Matrix3d const R = pose.T_world_camera.linear();
    return (R - Eigen::Matrix3d::Identity()).cwiseAbs().maxCoeff() > 1e-9;
  });
}

}  // namespace

raw_ground_truth find_ground_truth(layout_of_files const& layout,
                                   std::vector<std::string>& warnings) {
  raw_ground_truth truth;
  std::string const euroc = (layout.mav0 / "state_groundtruth_estimate0" / "data.csv").string();
  std::string const mocap = (layout.mav0 / "mocap0" / "data.csv").string();
  std::string const tum = (layout.root / "groundtruth.txt").string();
  std::string const kitti = (layout.root / "poses.txt").string();
  // KITTI's own tree: sequences/07 and poses/07.txt.
  std::string const beside = (layout.root.parent_path().parent_path() / "poses" /
                              (layout.root.filename().string() + ".txt"))
                                 .string();
  if (!layout.mav0.empty() && (is_file(euroc) || is_file(mocap))) {
    truth.poses = read_euroc_truth(is_file(euroc) ? euroc : mocap, warnings);
    truth.of = raw_ground_truth::body;
    truth.orientation = !truth.poses.empty();
  } else if (is_file(tum)) {
    truth.poses = read_tum_poses(tum, layout, warnings);
    truth.orientation = any_rotation(truth.poses);
  } else if (!layout.y_up_truth.empty()) {
    truth.poses = read_tum_poses(layout.y_up_truth, layout, warnings);
    truth.orientation = any_rotation(truth.poses);
    truth.y_up = true;
  } else if (is_file(kitti) || is_file(beside)) {
    truth.poses = read_kitti_poses(is_file(kitti) ? kitti : beside, layout.times);
    truth.of = raw_ground_truth::kitti_reference;
    truth.orientation = any_rotation(truth.poses);
  } else if (layout.name == "kitti_raw" && is_directory((layout.root / "oxts" / "data").string())) {
    truth.poses = read_oxts(layout.root / "oxts", warnings);
    truth.of = raw_ground_truth::body;
    truth.orientation = any_rotation(truth.poses);
  } else if (!layout.poses.empty()) {
    truth.poses = read_pose_files(layout.poses, warnings);
    truth.orientation = any_rotation(truth.poses);
  }
  return truth;
}

}  // namespace seq::detail

// SPDX-License-Identifier: Apache-2.0
/// @file What an odometry knows about its loops, as a file: it follows the map's.
///
/// Version 4, little-endian, without padding:
/// - 16 bytes "ft loop archive" and 0; uint32 version; uint32 0x01020304; uint64 bytes that follow
///   before the hash;
/// - int32 keyframes, int32 loops, double gravity[3];
/// - each keyframe: its numbers by each_number(), int32 points, and of each array of
///   loop_archive_view after `count` so many entries;
/// - each loop: its numbers;
/// - uint64 FNV-1a hash of the bytes after the head.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <istream>
#include <memory>
#include <ostream>
#include <string>
#include <vector>

#include "ft/containers/columns.hpp"
#include "ft/containers/loop_archive.hpp"
#include "ft/containers/pose_graph.hpp"
#include "ft/core/config.hpp"
#include "ft/core/detail/read_stream.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/pipelines/detail/loop_path.hpp"
#include "ft/pipelines/detail/map_checks.hpp"
#include "ft/pipelines/detail/odometry_files.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

struct loop_file_head {
  char magic[16] = "ft loop archive";
  std::uint32_t version = 4;
  std::uint32_t order = 0x01020304;
  std::uint64_t bytes = 0;
};
static_assert(sizeof(loop_file_head) == 32, "without padding");

template <typename Visit>
void each_number(path_keyframe& k, Visit const& visit) {
  visit(k.map, k.part, k.steps, k.time_ns, k.step, k.T_odom_camera, k.T_world_camera,
        k.information);
}
template <typename Visit>
void each_number(path_loop& l, Visit const& visit) {
  visit(l.from, l.to, l.inliers, l.T_from_to, l.information, l.scale_information);
}

/// Calls visit(array, count) for what is kept of a keyframe's points.
template <typename Visit>
void each_point_array(loop_archive_view const& archive, int row, Visit const& visit) {
  loop_archive_view one = skip_entries(archive, row);
  auto const n = static_cast<std::size_t>(archive.count[row]);
  each_column(one, [&](auto* array, extent const& e) {
    if (e.each > 1) { visit(array, n); }
  });
}

/// An archive in memory of the host, and the path of its keyframes, whose rows are 0, 1, ...
template <memory_space Space>
struct saved_loops {
  owner<loop_archive_view, Space> archive;
  std::vector<path_keyframe> keyframes;
  std::vector<path_loop> loops;
  vec3<double> gravity{0, 0, 0};

  saved_loops(int rows, int points)
      : archive([&](carver& c, loop_archive_view& v) { carve(c, v, rows, points); }) {}
};

/// Writes what is saved, of which each keyframe says its row.
template <memory_space Space>
void write_loops(saved_loops<Space> const& saved, std::ostream& to) {
  std::string bytes;
  auto const put = [&bytes](auto const&... values) {
    (bytes.append(reinterpret_cast<char const*>(&values), sizeof values), ...);
  };
  put(static_cast<int>(saved.keyframes.size()), static_cast<int>(saved.loops.size()),
      saved.gravity);
  for (path_keyframe k : saved.keyframes) {
    each_number(k, put);
    put(saved.archive->count[k.row]);
    each_point_array(saved.archive.view(), k.row, [&](auto* array, std::size_t n) {
      bytes.append(reinterpret_cast<char const*>(array), n * sizeof *array);
    });
  }
  for (path_loop l : saved.loops) { each_number(l, put); }
  loop_file_head head;
  head.bytes = bytes.size();
  std::uint64_t const hash = fnv1a(bytes.data(), bytes.size(), fnv1a_start);
  to.write(reinterpret_cast<char const*>(&head), sizeof head);
  to.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  to.write(reinterpret_cast<char const*>(&hash), sizeof hash);
}

/// A copy of the rows that are in use, to be written at any time. Waits, and allocates.
template <typename Exec>
map_snapshot::writer loop_writer(Exec const& exec, loop_archive_view const& archive,
                                 loop_path const& path) {
  int rows = 4;
  for (path_keyframe const& k : path.keyframes) { rows = std::max(rows, k.row + 1); }
  auto const saved = std::make_shared<saved_loops<memory_space::host>>(std::min(rows, archive.rows),
                                                                       archive.points);
  saved->keyframes = path.keyframes;
  saved->loops = path.loops;
  saved->gravity = path.gravity;
  copy_columns(exec, saved->archive.view(), archive);
  exec.wait();
  return [saved](std::ostream& to) { write_loops(*saved, to); };
}

/// The numbers of a file, one after the other.
class loop_file_reader {
public:
  /// @throws error for what is no such file, or is truncated or damaged
  explicit loop_file_reader(std::istream& from) {
    loop_file_head const ours;
    loop_file_head head;
    from.read(reinterpret_cast<char*>(&head), sizeof head);
    if (from.gcount() != sizeof head ||
        std::memcmp(&head, &ours, offsetof(loop_file_head, bytes)) != 0) {
      throw error("ft: the map file has no loops of this version behind its map");
    }
    constexpr std::uint64_t most = std::uint64_t{1} << 40;
    require_saved("bytes of loops", head.bytes, std::uint64_t{0}, most);
    file_ = read_up_to(from, static_cast<std::size_t>(head.bytes));
    std::uint64_t hash = 0;
    from.read(reinterpret_cast<char*>(&hash), sizeof hash);
    if (file_.size != head.bytes || from.gcount() != sizeof hash) {
      throw error("ft: the map file is truncated: its loops are not whole");
    }
    if (hash != fnv1a(file_.data.get(), file_.size, fnv1a_start)) {
      throw error("ft: the loops of the map file are damaged");
    }
    if (bytes_left(from) != 0) { throw error("ft: the map file has bytes after its end"); }
  }
  template <typename T>
  void take(T* to, std::size_t n) {
    if (n * sizeof(T) > file_.size - at_) {
      throw error("ft: the loops of the map file are damaged: numbers are missing");
    }
    std::memcpy(static_cast<void*>(to), file_.data.get() + at_, n * sizeof(T));
    at_ += n * sizeof(T);
  }
  bool at_end() const { return at_ == file_.size; }

private:
  file_bytes file_;
  std::size_t at_ = 0;
};

inline void check_saved_information(double const (&information)[21]) {
  for (double const v : information) { require_saved("an information of an edge", v, -1e30, 1e30); }
  if (!is_semidefinite<6>(information)) {
    throw error("ft: the map file has an information of an edge that is not semidefinite");
  }
}

/// @param scaled whether its scale may be another one than 1
inline void check_saved_similarity(similarity<double> const& T, bool scaled) {
  check_saved_pose(without_scale(T));
  if (!scaled && T.scale != 1) {
    throw error("ft: the map file has scales: it is of one camera without an IMU");
  }
  constexpr double most = 10 * loop_path::most_scale;  // it is optimised, and drifts
  require_saved("a scale", T.scale, 1 / most, most);
}

/// @param cameras of the rig
inline void check_saved_row(loop_archive_view const& a, int row, int cameras) {
  int camera = 0;
  for (std::ptrdiff_t i = a.at(row); i < a.at(row) + a.count[row]; ++i) {
    for (float const v : {a.point[i].x, a.point[i].y, a.point[i].z}) {
      require_saved("a coordinate of a point", v, -farthest_saved, farthest_saved);
    }
    require_saved("a column of a keypoint", a.x[i], -farthest_pixel, farthest_pixel);
    require_saved("a row of a keypoint", a.y[i], -farthest_pixel, farthest_pixel);
    require_saved("a right column of a keypoint", a.right_x[i], -farthest_pixel, farthest_pixel);
    require_saved("an inverse variance of a keypoint", a.inv_sigma2[i], 1e-9f, 1e9f);
    require_saved("a camera of a keypoint", a.camera[i], camera, cameras - 1);
    camera = a.camera[i];
  }
}

/// Maps of the file get the numbers up to 1: the last one is the map that was saved.
inline void renumber_maps(std::vector<path_keyframe>& keyframes) {
  if (keyframes.empty()) { return; }
  int const last = keyframes.back().map;
  int const part = keyframes.back().part;
  for (path_keyframe& k : keyframes) {
    k.map += 1 - last;
    k.part = k.part == part ? 1 : k.part - last;
  }
}

/// What a file with loops may have.
struct loop_file_limits {
  int keyframes;
  int loops;
  int cameras;  ///< of the rig
  bool scaled;  ///< as in loop_path
};

/// Reads and checks a whole file.
/// @throws error for a file that is truncated, damaged, larger than there is room for, or has
///   numbers out of range
template <typename Exec>
saved_loops<staging_space<Exec>> read_loops(loop_archive_view const& like,
                                            loop_file_limits const& most, std::istream& from) {
  loop_file_reader in(from);
  auto const get = [&in](auto&... values) { (in.take(&values, 1), ...); };
  saved_loops<staging_space<Exec>> to(like.rows, like.points);
  loop_archive_view const& a = to.archive.view();
  int keyframes = 0, loops = 0, steps = 0;
  get(keyframes, loops, to.gravity);
  require_saved("keyframes of loops", keyframes, 0, most.keyframes);
  require_saved("loops", loops, 0, most.loops);
  double const gravity[3] = {to.gravity.x, to.gravity.y, to.gravity.z};
  for (double const g : gravity) { require_saved("gravity", g, -1e3, 1e3); }
  double const square = dot(to.gravity, to.gravity);
  require_saved("squared gravity", square, square > 0 ? 1e-12 : 0.0, 1e7);
  for (int i = 0; i < keyframes; ++i) {
    path_keyframe k;
    each_number(k, get);
    k.row = i;
    constexpr int most_maps = most_counted / 2;
    int const least_map = to.keyframes.empty() ? -most_maps : to.keyframes.back().map;
    require_saved("the number of a map", k.map, least_map, most_maps);
    require_saved("the number of a part", k.part, -most_maps, k.map);
    require_saved("the steps of a keyframe", k.steps, 1, most_counted - steps);
    steps += k.steps;
    require_saved("the way to a keyframe", k.step, 0.0, 1e12);
    check_saved_pose(k.T_odom_camera);
    check_saved_similarity(k.T_world_camera, most.scaled);
    check_saved_information(k.information);
    get(a.count[i]);
    require_saved("points of a keyframe", a.count[i], 0, a.points);
    each_point_array(a, i, [&in](auto* array, std::size_t n) { in.take(array, n); });
    check_saved_row(a, i, most.cameras);
    to.keyframes.push_back(k);
  }
  for (int i = 0; i < loops; ++i) {
    path_loop l;
    each_number(l, get);
    require_saved("the end of a loop", l.to, 1, keyframes - 1);
    require_saved("the begin of a loop", l.from, 0, l.to - 1);
    require_saved("the inliers of a loop", l.inliers, 0, a.points);
    check_saved_similarity(l.T_from_to, most.scaled);
    require_saved("the information of a scale", l.scale_information, 0.0, 1e30);
    check_saved_information(l.information);
    to.keyframes[static_cast<std::size_t>(l.to)].again = true;
    to.loops.push_back(l);
  }
  if (!in.at_end()) { throw error("ft: the loops of the map file are damaged: too many numbers"); }
  renumber_maps(to.keyframes);
  return to;
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft

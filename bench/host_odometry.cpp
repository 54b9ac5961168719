// SPDX-License-Identifier: Apache-2.0
#include "bench/odometry_runner.hpp"

namespace bench {
namespace {

ft::allocated_bytes bytes_of(scene const& s, ft::odometry_params const& p) {
  ft::odometry const odometry(ft::host_exec(1), rig_of<ft::rectified_rig>(s), p);
  return odometry.memory_bytes();
}

}  // namespace

std::vector<odometry_memory_row> odometry_memory(scene const& s) {
  ft::odometry_params const usual = odometry_params_of(s, {});
  ft::allocated_bytes const all = bytes_of(s, usual);
  std::vector<odometry_memory_row> rows;
  auto const add = [&](char const* what, int count, ft::odometry_params const& more, int by) {
    ft::allocated_bytes const b = bytes_of(s, more);
    rows.push_back({what, count, static_cast<double>(b.executor - all.executor) / by,
                    static_cast<double>(b.staging - all.staging) / by});
  };
  ft::odometry_params p = usual;
  p.map_slots += 1 << 14;
  add("map slot", usual.map_slots, p, 1 << 14);
  p = usual;
  p.keyframes += 64;
  add("keyframe", usual.keyframes, p, 64);
  p = usual;
  p.local_points += 1 << 13;
  add("local point", usual.local_points, p, 1 << 13);
  p = usual;
  p.window_points += 1 << 12;
  add("window point", usual.window_points, p, 1 << 12);
  p = usual;
  p.orb.features += 1000;
  add("feature of an image", usual.orb.features, p, 1000);
  rows.push_back({"whole", 1, static_cast<double>(all.executor), static_cast<double>(all.staging)});
  return rows;
}

std::unique_ptr<odometry_runner> make_host_odometry(scene const& s, frame_options const& how) {
  return make_odometry_runner_of<ft::host_exec>(s, how);
}

}  // namespace bench

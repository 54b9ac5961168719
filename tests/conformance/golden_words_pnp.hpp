// SPDX-License-Identifier: Apache-2.0
/// @file Compares poses from points (RANSAC with MLPnP) with the cases pnp/* of golden_words.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

/// One recorded problem on one executor.
template <typename Exec>
class golden_pnp {
public:
  golden_pnp(Exec const& exec, std::string const& folder)
      : exec_(exec),
        folder_(folder + "/"),
        X_(read_npy<float>(folder_ + "X.npy")),
        keypoint_(read_npy<std::int32_t>(folder_ + "keypoint.npy")),
        memory_([&](ft::carver& c) {
          carve(c, problems_, 1, X_.rows());
          carve(c, results_, 1, X_.rows());
          carve(c, work_, problems_, params_);
        }) {
    auto const n = static_cast<std::size_t>(X_.rows());
    put(problems_.count, std::vector<int>{X_.rows()});
    put(problems_.seed, read_npy<std::uint64_t>(folder_ + "seed.npy").data);
    put(problems_.max_error2, read_npy<float>(folder_ + "e2max.npy").data);
    put(problems_.keypoint, keypoint_.data);
    auto const pixel = read_npy<float>(folder_ + "p2d.npy");
    std::vector<ft::vec2<float>> pixels(n);
    std::vector<ft::vec3<float>> points(n);
    for (int i = 0; i < X_.rows(); ++i) {
      pixels[static_cast<std::size_t>(i)] = {pixel(i, 0), pixel(i, 1)};
      points[static_cast<std::size_t>(i)] = {X_(i, 0), X_(i, 1), X_(i, 2)};
    }
    put(problems_.pixel, pixels);
    put(problems_.point, points);
  }

  template <typename Camera>
  void run(conformance_table& table, Camera const& camera) const {
    compare_rays(table["pnp_rays"], camera);
    compare_limits(table["pnp_limits"]);
    ft::start_pnp(exec_, work_);
    auto const calls = read_npy<std::int32_t>(folder_ + "call_ok_nomore_n_done.npy");
    for (int k = 0; k < calls.rows(); ++k) {
      ft::continue_pnp(exec_, camera, problems_, params_, results_, work_);
      if (k == 0) { compare_hypotheses(table); }
      compare_call(table, calls, k);
    }
    if (exists(folder_ + "refined_pose.npy")) { compare_refined(table, camera); }
  }

private:
  template <typename T>
  void put(T* to, std::vector<T> const& values) const {
    ft::copy(exec_, to, values.data(), values.size());
    exec_.wait();
  }
  int count() const { return X_.rows(); }

  /// Leaves the recorded rays.
  template <typename Camera>
  void compare_rays(stage_result& r, Camera const& camera) const {
    auto const n = static_cast<std::size_t>(count());
    ft::pnp_rays(exec_, camera, problems_);
    auto got = from_exec(exec_, problems_.ray, n);
    auto const want = read_npy<double>(folder_ + "bearing.npy");
    for (int i = 0; i < count(); ++i) {
      auto& ray = got[static_cast<std::size_t>(i)];
      double const d = std::max({std::abs(ray.x - want(i, 0)), std::abs(ray.y - want(i, 1)),
                                 std::abs(ray.z - want(i, 2))});
      r.add(d <= 1e-4, d);
      ray = {want(i, 0), want(i, 1), want(i, 2)};
    }
    put(problems_.ray, got);
  }
  void compare_limits(stage_result& r) const {
    auto const want = read_npy<std::int32_t>(folder_ + "m_K.npy");
    auto const limits = ft::pnp_limits_of(count(), params_);
    r.add(limits.inliers == want(0));
    r.add(limits.iterations == want(1));
  }

  /// Of all elements, by the largest one.
  template <typename T, typename U>
  static double pose_distance(ft::rigid<T> const& T_cw, npy<U> const& want, int row, int columns) {
    double apart = 0;
    double size = 0;
    for (int i = 0; i < 3; ++i) {
      for (int k = 0; k < 4; ++k) {
        T const got = k < 3 ? T_cw.R.m[3 * i + k]
                            : (i == 0   ? T_cw.t.x
                               : i == 1 ? T_cw.t.y
                                        : T_cw.t.z);
        auto const other =
            static_cast<double>(want.data.at(static_cast<std::size_t>(row + columns * i + k)));
        apart = std::max(apart, std::abs(static_cast<double>(got) - other));
        size = std::max(size, std::abs(other));
        if (std::isnan(static_cast<double>(got)) != std::isnan(other)) { return HUGE_VAL; }
      }
    }
    return apart == 0 ? 0 : apart / size;
  }

  /// The hypotheses of the plan, also those behind the winner. Of a case 95 % of the poses must
  /// agree, and 98 % of the counts: an ill-conditioned sample may be anywhere.
  void compare_hypotheses(conformance_table& table) const {
    auto const want_pose = read_npy<double>(folder_ + "pose.npy");
    auto const want_count = read_npy<std::int32_t>(folder_ + "count.npy");
    auto const slots = static_cast<std::size_t>(work_.hypotheses);
    auto const pose = from_exec(exec_, work_.T_cw, slots);
    auto const inliers = from_exec(exec_, work_.inliers, slots);
    auto const done = from_exec(exec_, work_.state, 1)[0].evaluated;  // 0 of too few
    int poses_off = 0;
    int counts_off = 0;
    double worst = 0;
    for (int h = 0; h < done; ++h) {
      double const d = pose_distance(pose[static_cast<std::size_t>(h)], want_pose, 12 * h, 4);
      poses_off += static_cast<int>(!(d <= 1e-6));
      if (d <= 1e-6) { worst = std::max(worst, d); }
      counts_off += static_cast<int>(inliers[static_cast<std::size_t>(h)] != want_count(h));
    }
    add_share(table["pnp_poses"], done, poses_off, poses_off <= 0.05 * done);
    table["pnp_poses"].max_abs_diff = std::max(table["pnp_poses"].max_abs_diff, worst);
    add_share(table["pnp_counts"], done, counts_off, counts_off <= std::max(1.0, 0.02 * done));
  }
  /// Items that differ count as such where there are more than allowed.
  static void add_share(stage_result& r, int items, int off, bool allowed) {
    for (int i = 0; i < items; ++i) { r.add(allowed || i >= off); }
  }

  void compare_call(conformance_table& table, npy<std::int32_t> const& calls, int k) const {
    auto const result = from_exec(exec_, results_.result, 1)[0];
    auto& r = table["pnp_calls"];
    bool const pose = ft::has_pose(result.status);
    r.add(pose == (calls(k, 0) != 0));
    r.add(ft::no_more(result.status) == (calls(k, 1) != 0));
    r.add(result.inliers == calls(k, 2));
    r.add(result.done == calls(k, 3));
    auto const inlier = from_exec(exec_, results_.inlier, static_cast<std::size_t>(count()));
    auto const want = read_npy<std::uint8_t>(folder_ + "call_inlier.npy");
    std::vector<std::uint8_t> of_frame(static_cast<std::size_t>(want.cols()), 0);
    for (int i = 0; i < count(); ++i) {
      if (inlier[static_cast<std::size_t>(i)] != 0) {
        of_frame[static_cast<std::size_t>(keypoint_(i))] = 1;
      }
    }
    for (int i = 0; i < want.cols(); ++i) {
      r.add((of_frame[static_cast<std::size_t>(i)] != 0) == (want(k, i) != 0));
    }
    if (pose) {
      double const d =
          pose_distance(result.T_cw, read_npy<float>(folder_ + "call_T.npy"), 16 * k, 4);
      table["pnp_call_poses"].add(d <= 1e-5, d);
    }
  }

  template <typename Camera>
  void compare_refined(conformance_table& table, Camera const& camera) const {
    auto const n = static_cast<std::size_t>(count());
    put(results_.inlier, read_npy<std::uint8_t>(folder_ + "refined_from.npy").data);
    ft::refine_pnp(exec_, camera, problems_, results_, results_, work_);
    auto const result = from_exec(exec_, results_.result, 1)[0];
    double const d =
        pose_distance(result.T_cw, read_npy<double>(folder_ + "refined_pose.npy"), 0, 4);
    table["pnp_refined"].add(d <= 1e-6, d);
    auto const got = from_exec(exec_, results_.inlier, n);
    auto const want = read_npy<std::uint8_t>(folder_ + "refined_inlier.npy");
    for (std::size_t i = 0; i < n; ++i) { table["pnp_refined"].add(got[i] == want.data[i]); }
  }

  Exec const& exec_;
  std::string folder_;
  npy<float> X_;
  npy<std::int32_t> keypoint_;
  ft::pnp_params params_;
  ft::pnp_problems_view problems_;
  ft::pnp_results_view results_;
  ft::pnp_workspace work_;
  ft::arena<Exec::space> memory_;
};

/// The set of a case's camera.
inline std::string set_of_pnp(std::string const& name) {
  auto const begins = [&](char const* with) { return name.rfind(with, 0) == 0; };
  if (begins("kb8") || name == "synth_fisheye") { return "kb8"; }
  return begins("t265") ? "t265_mono" : begins("kitti") ? "kitti" : "euroc_mono";
}

/// A case of pnp, and the folder of golden_words.
template <typename Exec>
void compare_pnp(Exec const& exec, std::string const& folder, std::string const& words,
                 conformance_table& table) {
  std::string const name = folder.substr(folder.find_last_of('/') + 1);
  auto const c = read_npy<float>(words + "/sets/" + set_of_pnp(name) + "/camera1.npy").data;
  golden_pnp<Exec> const recorded(exec, folder);
  if (c.size() == 8) {
    recorded.run(table, ft::kannala_brandt<float>{c[0], c[1], c[2], c[3], c[4], c[5], c[6], c[7]});
  } else {
    recorded.run(table, ft::pinhole<float>{c.at(0), c.at(1), c.at(2), c.at(3)});
  }
}

}  // namespace test

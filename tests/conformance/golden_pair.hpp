// SPDX-License-Identifier: Apache-2.0
/// @file The searches and poses of a pair of frames of a golden folder.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <string>
#include <type_traits>
#include <vector>

#include "ft/containers/frame.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/pose/optimize_pose.hpp"
#include "ft/kernels/search/assignment.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "tests/conformance/conformance_table.hpp"
#include "tests/conformance/golden_folder.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

/// Frame k, the one before it, and the map points that they see.
template <typename Exec, typename Rig>
class golden_pair {
public:
  golden_pair(golden_folder<Exec>& of, Rig const& rig, int k)
      : of_(of),
        exec_(of.exec),
        rig_(rig),
        k_(k),
        cameras_(of.fisheye ? 2 : 1),
        capacity_(of.orb.capacity()),
        numbers_(static_cast<std::size_t>(cameras_ * capacity_)) {
    of_.load_frame(k, keypoints_);
    of_.load_frame(k - 1, last_keypoints_);
    counts_ = of_.template get_array<int>(keypoints_.view().count, 2);
    last_counts_ = of_.template get_array<int>(last_keypoints_.view().count, 2);
    load_map();
    load_partners();
    most_ = std::max(cameras_ * capacity_, map_.capacity());
    memory_ = ft::arena<Exec::space>([&](ft::carver& c) {
      ft::carve(c, buffers_.windows, most_, 1, cameras_);
      ft::carve(c, buffers_.work, most_, capacity_, 1, cameras_);
      ft::carve(c, observations_, cameras_ * capacity_, 1);
    });
  }

  void run(conformance_table& table) {
    search_last(table["search_last_frame"]);
    for (std::string const po : {"po1_", "po2_"}) { compare_pose(table["pose_optimization"], po); }
    read_local();
    find_visible(table["frustum"]);
    search_local(table["search_local_map"]);
  }

private:
  /// The recorded local map and where it was seen.
  struct local_arrays {
    npy<std::int32_t> slots, in_view, level;
    npy<std::uint8_t> skip;
    npy<float> projection, right_projection, setting;
  };

  std::string path(char const* kind, std::string const& name) const {
    return of_.path(kind, k_, name);
  }

  void load_map() {
    auto const xyz = read_npy<float>(path("pair", "mp_xyz"));
    auto const normal = read_npy<float>(path("pair", "mp_normal"));
    auto const range = read_npy<float>(path("pair", "mp_dist_min_max"));
    auto const desc = read_npy<std::uint8_t>(path("pair", "mp_desc"));
    auto const nobs = read_npy<std::int32_t>(path("pair", "mp_nobs"));
    int const points = xyz.rows();
    ft::map_points<ft::memory_space::host> host_map(points);
    auto const hm = host_map.view();
    for (int i = 0; i < points; ++i) {
      hm.position(i) = {xyz(i, 0), xyz(i, 1), xyz(i, 2)};
      hm.normal(i) = {normal(i, 0), normal(i, 1), normal(i, 2)};
      hm.min_distance(i) = range(i, 0);
      hm.max_distance(i) = range(i, 1);
      std::memcpy(&hm.orb(i), &desc(i, 0), 32);
      hm.observations(i) = nobs(i);
    }
    *hm.count = points;
    map_ = ft::map_points<Exec::space>(points);
    ft::copy(exec_, map_.view(), hm);
    exec_.wait();
  }

  void load_partners() {
    auto const geometry = ft::grid_geometry::over(0, 0, static_cast<float>(of_.params.width),
                                                  static_cast<float>(of_.params.height));
    grid_ = ft::feature_grid<Exec::space>(geometry, capacity_, cameras_);
    ft::build_grid<ft::nearest_cell>(exec_, keypoints_.view(), 0, 1, cameras_, grid_.view());
    std::vector<float> right_x(static_cast<std::size_t>(capacity_), -1.0f);
    std::vector<int> partner(numbers_, -1);
    if (of_.fisheye) {
      auto const l2r = read_npy<std::int32_t>(path("frame", "l2r"));
      auto const r2l = read_npy<std::int32_t>(path("frame", "r2l"));
      for (int i = 0; i < l2r.rows(); ++i) {
        if (l2r(i) >= 0) { partner[static_cast<std::size_t>(i)] = capacity_ + l2r(i); }
      }
      for (int i = 0; i < r2l.rows(); ++i) {
        if (r2l(i) >= 0) { partner[static_cast<std::size_t>(capacity_ + i)] = r2l(i); }
      }
    } else {
      auto const u = read_npy<float>(path("frame", "mvuRight"));
      std::copy(u.data.begin(), u.data.end(), right_x.begin());
    }
    right_x_ = to_exec(exec_, right_x);
    partner_ = to_exec(exec_, partner);
    holder_ = ft::buffer<int, Exec::space>(numbers_);
    frame_.keypoints = keypoints_.view();
    frame_.cameras = cameras_;
    frame_.grids = grid_.view();
    frame_.right_x = of_.fisheye ? nullptr : right_x_.data();
    frame_.partner = of_.fisheye ? partner_.data() : nullptr;
    frame_.holder = holder_.data();
  }

  /// Golden arrays are left then right without a gap; ours leave room up to the capacity.
  std::vector<int> spread(std::vector<std::int32_t> const& packed,
                          std::vector<int> const& n) const {
    std::vector<int> v(numbers_, -1);
    for (int i = 0; i < static_cast<int>(packed.size()); ++i) {
      int const at = i < n[0] ? i : capacity_ + i - n[0];
      v[static_cast<std::size_t>(at)] = packed[static_cast<std::size_t>(i)];
    }
    return v;
  }

  void search_last(stage_result& r) {
    auto const last_mp = read_npy<std::int32_t>(path("pair", "last_mp"));
    auto const outlier = read_last_outlier(last_mp.rows());
    std::vector<std::int32_t> held(last_mp.data);
    for (std::size_t i = 0; i < held.size(); ++i) {
      if (outlier[i] != 0) { held[i] = -1; }
    }
    auto const d_last = to_exec(exec_, spread(held, last_counts_));
    ft::last_frame_view last{last_keypoints_.view(), 2, cameras_, d_last.data()};
    auto const d_pred = to_exec(exec_, std::vector<ft::pose>{of_.read_pose(k_, "Tcw_pred")});
    auto const d_tlw = to_exec(exec_, std::vector<ft::pose>{of_.read_pose(k_, "Tlw")});
    for (int ori = 1; ori >= 0; --ori) {
      std::string const name = ori != 0 ? "sbp_last" : "sbp_last_noori";
      auto const setting = read_npy<float>(path("pair", name + "_th_nnratio_n"));
      ft::last_search<Rig> search;
      search.rig = rig_;
      search.T_cw = d_pred.data();
      search.last_T_cw = d_tlw.data();
      search.last = last;
      search.geometry = of_.orb.geometry();
      search.params.window_radius = setting(0);
      search.params.reference_quirks = true;
      search.params.max_x = static_cast<float>(of_.params.width);
      search.params.max_y = static_cast<float>(of_.params.height);
      search.params.orientation_check = ori != 0;
      ft::search_last_frame(exec_, search, frame_, map_.view(), buffers_);
      compare_holders(r, spread(read_npy<std::int32_t>(path("pair", name)).data, counts_),
                      of_.template get_array<int>(frame_.holder, numbers_));
      r.add(of_.template get_array<int>(buffers_.work.matches, 1)[0] ==
            static_cast<int>(setting(2)));
    }
  }

  void read_local() {
    local_.slots = read_npy<std::int32_t>(path("pair", "local_mp"));
    local_.skip = read_npy<std::uint8_t>(path("pair", "local_skip"));
    local_.in_view = read_npy<std::int32_t>(path("pair", "local_inview"));
    local_.level = read_npy<std::int32_t>(path("pair", "local_level"));
    local_.projection = read_npy<float>(path("pair", "local_proj"));
    if (of_.fisheye) { local_.right_projection = read_npy<float>(path("pair", "local_projR")); }
    local_.setting = read_npy<float>(path("pair", "sbp_local_th_nnratio_n"));
  }

  void find_visible(stage_result& r) {
    int const q = local_.slots.rows();
    std::vector<std::int32_t> slots(static_cast<std::size_t>(most_), -1);
    for (int i = 0; i < q; ++i) {
      slots[static_cast<std::size_t>(i)] = local_.skip(i) != 0 ? -1 : local_.slots(i);
    }
    auto const d_slots = to_exec(exec_, slots);
    auto const d_count = to_exec(exec_, std::vector<int>{q});
    auto const d_local = to_exec(exec_, std::vector<ft::pose>{of_.read_pose(k_, "Tcw_local")});
    auto const all = static_cast<std::size_t>(most_ * cameras_);
    ft::buffer<ft::visibility, Exec::space> seen(all);
    ft::frustum_params fp;
    fp.max_x = static_cast<float>(of_.params.width);
    fp.max_y = static_cast<float>(of_.params.height);
    fp.log_scale_factor = ft::log_rounded(of_.params.scale_factor);
    fp.levels = of_.params.levels;
    ft::local_search_params lp;
    lp.radius_factor = local_.setting(0);
    ft::local_search<Rig> const search{
        rig_, d_local.data(), d_slots.data(), d_count.data(), {}, fp, of_.orb.geometry(),
        lp,   seen.data()};
    ft::find_visible_points(exec_, search, map_.view(), buffers_.windows);
    auto const vis = of_.template get_array<ft::visibility>(seen.data(), all);
    for (int i = 0; i < q; ++i) {
      if (local_.skip(i) != 0) { continue; }
      for (int c = 0; c < cameras_; ++c) {
        auto const& v = vis[static_cast<std::size_t>(c * most_ + i)];
        double diff = 0;
        if (v.level >= 0 && c == 0 && local_.in_view(i, 0) != 0) {
          diff = std::max(std::abs(v.x - local_.projection(i, 0)),
                          std::abs(v.y - local_.projection(i, 1)));
        }
        r.add((v.level >= 0) == (local_.in_view(i, c) != 0) &&
                  (v.level < 0 || v.level == local_.level(i, c)),
              diff);
      }
    }
  }

  /// Where camera c has recorded point i of the local map.
  ft::visibility recorded_view(int i, int c) const {
    auto const& l = local_.projection;
    if (c == 0) { return {l(i, 0), l(i, 1), l(i, 2), l(i, 3), l(i, 4), local_.level(i, 0)}; }
    auto const& right = local_.right_projection;
    return {right(i, 0), right(i, 1), 0, right(i, 2), right(i, 3), local_.level(i, 1)};
  }
  /// From the recorded projections.
  void search_local(stage_result& r) {
    auto const before =
        spread(read_npy<std::int32_t>(path("pair", "cur_mp_before_local")).data, counts_);
    ft::copy(exec_, holder_.data(), before.data(), numbers_);
    std::vector<ft::search_window> recorded(static_cast<std::size_t>(most_ * cameras_),
                                            ft::search_window::none());
    for (int i = 0; i < local_.slots.rows(); ++i) {
      for (int c = 0; c < cameras_; ++c) {
        if (local_.in_view(i, c) == 0) { continue; }
        recorded[static_cast<std::size_t>(c * most_ + i)] =
            ft::window_of(recorded_view(i, c), local_.slots(i), c == 0 ? local_.setting(0) : 1.0f,
                          !of_.fisheye, of_.orb.geometry());
      }
    }
    ft::copy(exec_, buffers_.windows.windows, recorded.data(), recorded.size());
    ft::search_params sp;
    sp.ratio = local_.setting(1);
    ft::search_by_projection(exec_, frame_, map_.view(), sp, buffers_);
    compare_holders(
        r, spread(read_npy<std::int32_t>(path("pair", "cur_mp_after_local")).data, counts_),
        of_.template get_array<int>(frame_.holder, numbers_));
    r.add(of_.template get_array<int>(buffers_.work.matches, 1)[0] ==
          static_cast<int>(local_.setting(2)));
  }

  std::vector<int> read_last_outlier(int n) {
    auto const file = path("pair", "last_outlier");
    std::vector<int> v;
    auto const a = read_npy<std::uint8_t>(file);
    for (int i = 0; i < n; ++i) { v.push_back(a(i)); }
    return v;
  }

  void compare_holders(stage_result& r, std::vector<int> const& want,
                       std::vector<int> const& got) const {
    for (int c = 0; c < cameras_; ++c) {
      for (int i = 0; i < counts_[static_cast<std::size_t>(c)]; ++i) {
        auto const at = static_cast<std::size_t>(c * capacity_ + i);
        r.add(want[at] == got[at]);
      }
    }
  }

  void compare_pose(stage_result& r, std::string const& po) {
    if (!exists(path("pair", po + "Xw"))) { return; }
    auto const X = read_npy<float>(path("pair", po + "Xw"));
    auto const obs = read_npy<float>(path("pair", po + "obs"));
    auto const w = read_npy<float>(path("pair", po + "invSigma2"));
    auto const outlier = read_npy<std::uint8_t>(path("pair", po + "outlier"));
    auto const right = read_npy<std::uint8_t>(path("pair", po + "right"));
    int const n = X.rows();
    std::vector<ft::observation> items;
    for (int i = 0; i < n; ++i) {
      items.push_back({{X(i, 0), X(i, 1), X(i, 2)},
                       obs(i, 0),
                       obs(i, 1),
                       of_.fisheye ? -1.0f : obs(i, 2),
                       w(i),
                       right(i)});
    }
    ft::copy(exec_, observations_.items, items.data(), items.size());
    auto const start = to_exec(exec_, std::vector<ft::pose>{of_.read_pose(k_, po + "Tin")});
    ft::buffer<ft::pose, Exec::space> result(1);
    ft::optimize_pose(exec_, rig_,
                      {observations_.items, n, start.data(), result.data(), observations_.outlier,
                       observations_.inliers});
    auto const got = of_.template get_array<ft::pose>(result.data(), 1)[0];
    auto const flags =
        of_.template get_array<unsigned char>(observations_.outlier, static_cast<std::size_t>(n));
    auto const want = of_.read_pose(k_, po + "Tout");
    double worst = 0;
    for (int i = 0; i < 9; ++i) {
      worst = std::max(worst, static_cast<double>(std::abs(got.R.m[i] - want.R.m[i])));
    }
    worst = std::max({worst, std::abs(static_cast<double>(got.t.x - want.t.x)),
                      std::abs(static_cast<double>(got.t.y - want.t.y)),
                      std::abs(static_cast<double>(got.t.z - want.t.z))});
    r.add(worst < 1e-4, worst);
    for (int i = 0; i < n; ++i) { r.add(flags[static_cast<std::size_t>(i)] == outlier(i)); }
  }

  golden_folder<Exec>& of_;
  Exec exec_;
  Rig rig_;
  int k_, cameras_, capacity_;
  std::size_t numbers_;
  int most_ = 0;  ///< points or keypoints
  ft::keypoints<Exec::space> keypoints_, last_keypoints_;
  std::vector<int> counts_, last_counts_;
  ft::map_points<Exec::space> map_;
  ft::feature_grid<Exec::space> grid_;
  ft::buffer<float, Exec::space> right_x_;
  ft::buffer<int, Exec::space> partner_, holder_;
  ft::frame_view frame_;
  ft::search_buffers buffers_;
  ft::observations_view observations_;
  ft::arena<Exec::space> memory_;
  local_arrays local_;
};

}  // namespace test

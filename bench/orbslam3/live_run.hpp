// SPDX-License-Identifier: Apache-2.0
/// @file The shim's calls frame by frame while a mapper adds and moves points: the time of each
/// call.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdio>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "bench/orbslam3/world.hpp"
#include "integration/orbslam3/accelerator.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace bench {

struct live_options {
  int points = 4000;  ///< of the local map
  int frames = 300;
  int keyframe_every = 10;
  int new_points = 300;     ///< per keyframe; half of them are held by the next frame's last one
  int moved_points = 2000;  ///< per keyframe, by local bundle adjustment
  int pause_us = 3000;      ///< between frames
  bool samples = false;     ///< also put every frame's times into the results
};

class live_run {
public:
  using accelerator = ft::orbslam3::accelerator<stand_in::types>;
  using stage = ft::orbslam3::stage;

  live_run(live_options const& o, std::unique_ptr<ft::orbslam3::device_tracker> device)
      : options_(o),
        settings_(kitti()),
        gpu_(std::move(device), settings_, choices()),
        hooks_(gpu_) {
    for (int i = 0; i < 2; ++i) {
      left_[i] = picture(settings_, 2 * i);
      right_[i] = picture(settings_, disparity + 2 * i);
    }
  }

  void run() {
    stand_in::frame last;
    construct(last);
    keypoints_ = last.N;
    float const depth = settings_.bf / static_cast<float>(disparity);
    scattered_map map(last, settings_, options_.points, depth);
    for (auto* p : map.local) { p->observer = &hooks_; }
    std::size_t const held = std::min<std::size_t>(600, last.mvpMapPoints.size());
    for (std::size_t i = 0; i < held; ++i) { last.mvpMapPoints[i] = map[i]; }
    for (int k = 0; k < options_.frames + warm_up; ++k) {
      counted_ = k >= warm_up;
      if (k % options_.keyframe_every == 0) {
        std::thread([&] { make_keyframe(map, last); }).join();
      }
      std::this_thread::sleep_for(std::chrono::microseconds(options_.pause_us));
      double const before = sum_;
      stand_in::frame f;
      construct(f);
      track(f, last, map);
      f.SetPose({});
      last = f;
      if (counted_) { totals_["all"].push_back(sum_ - before); }
    }
  }

  void print(char const* title, std::map<std::string, std::vector<double>> const& all) const {
    std::printf("%s\n%-28s %9s %9s %9s\n", title, "us", "p50", "p99", "max");
    for (auto const& [name, v] : all) {
      std::printf("%-28s %9.1f %9.1f %9.1f\n", name.c_str(), quantile(v, 0.5), quantile(v, 0.99),
                  quantile(v, 1));
    }
  }
  std::map<std::string, std::vector<double>> const& totals() const { return totals_; }
  nlohmann::json facts() const {
    auto const frames = static_cast<double>(options_.frames);
    return {{"keypoints", keypoints_},
            {"matches_per_frame", static_cast<double>(matches_) / frames},
            {"inliers_per_frame", static_cast<double>(inliers_) / frames},
            {"in_view_per_frame", static_cast<double>(in_view_) / frames},
            {"map_slots", gpu_.mirror().capacity()}};
  }

  static double quantile(std::vector<double> v, double q) {
    std::sort(v.begin(), v.end());
    return v.empty() ? 0 : v[static_cast<std::size_t>(q * static_cast<double>(v.size() - 1))];
  }

private:
  static constexpr int warm_up = 25;    ///< frames
  static constexpr int disparity = 10;  ///< pixels

  struct push_changes final : stand_in::hooks {
    explicit push_changes(accelerator& a) : gpu(&a) {}
    void changed(stand_in::map_point* point) override { gpu->map_point_changed(point); }
    accelerator* gpu;
  };

  static ft::orbslam3::options choices() {
    ft::orbslam3::options c;
    c.detection = ft::orbslam3::change_detection::hooks;
    return c;
  }

  /// Calls f and notes its time.
  template <typename F>
  auto timed(stage s, F const& f) {
    auto const begin = std::chrono::steady_clock::now();
    auto const result = f();
    double const us =
        std::chrono::duration<double, std::micro>(std::chrono::steady_clock::now() - begin).count();
    sum_ += us;
    if (!counted_) { return result; }
    totals_[std::to_string(static_cast<int>(s)) + " " + name_of(s)].push_back(us);
    return result;
  }

  void construct(stand_in::frame& f) {
    f.mnId = id_;
    f.mnMaxX = static_cast<float>(settings_.width);
    f.mnMaxY = static_cast<float>(settings_.height);
    gpu_.expect_images();
    stand_in::matrix const left = left_[id_ % 2].clone();  // as System::TrackStereo does
    stand_in::matrix const right = right_[id_ % 2].clone();
    timed(stage::extract, [&] {
      gpu_.extract(left, right, f);
      return 0;
    });
    f.mvKeysUn = f.mvKeys;  // the CPU's, which is not timed
    timed(stage::stereo, [&] {
      gpu_.compute_stereo(f);
      return 0;
    });
    f.mvpMapPoints.assign(static_cast<std::size_t>(f.N), nullptr);
    f.mvbOutlier.assign(static_cast<std::size_t>(f.N), false);
    ++id_;
  }

  void track(stand_in::frame& f, stand_in::frame const& last, scattered_map const& map) {
    int found = timed(stage::search_last_frame,
                      [&] { return gpu_.search_by_projection(f, last, 7, false); });
    timed(stage::pose_last_frame,
          [&] { return gpu_.pose_optimization(f, stage::pose_last_frame); });
    for (std::size_t i = 0; i < f.mvpMapPoints.size(); ++i) {
      auto*& p = f.mvpMapPoints[i];
      if (p == nullptr) { continue; }
      p->mnLastFrameSeen = f.mnId;
      p->mbTrackInView = false;
      if (f.mvbOutlier[i]) {
        f.mvbOutlier[i] = false;
        p = nullptr;
      }
    }
    // Tracking::UpdateLocalMap, which stays on the CPU, has just walked over all points.
    for (auto* p : map.local) { static_cast<void>(p->isBad()); }
    found +=
        timed(stage::search_local_map, [&] { return gpu_.search_local_points(f, map.local, 1); });
    int const inliers = timed(stage::pose_local_map,
                              [&] { return gpu_.pose_optimization(f, stage::pose_local_map); });
    if (!counted_) { return; }
    matches_ += found;
    inliers_ += inliers;
    in_view_ += std::count_if(map.local.begin(), map.local.end(),
                              [](auto const* p) { return p->mbTrackInView; });
  }

  /// The changes of a keyframe: new points for the last frame and the local map, whose oldest
  /// points are removed, and moved points.
  void make_keyframe(scattered_map& map, stand_in::frame& last) {
    auto const fresh = std::min(static_cast<std::size_t>(options_.new_points), map.local.size());
    std::size_t holders = fresh / 2;
    std::size_t at = 0;
    for (std::size_t i = 0; i < fresh; ++i) {
      stand_in::map_point* const old = map.local[(oldest_ + i) % map.local.size()];
      auto const descriptor = old->GetDescriptor();
      stand_in::map_point* const p = map.add(old->GetWorldPos(), descriptor.data, &hooks_);
      map.local[(oldest_ + i) % map.local.size()] = p;
      if (i >= holders) { continue; }
      while (at < last.mvpMapPoints.size() && last.mvpMapPoints[at] == nullptr) { ++at; }
      if (at == last.mvpMapPoints.size()) { continue; }
      stand_in::map_point& held = *last.mvpMapPoints[at];
      auto const seen = held.GetDescriptor();
      last.mvpMapPoints[at++] = map.add(held.GetWorldPos(), seen.data, &hooks_);
    }
    oldest_ = (oldest_ + fresh) % map.local.size();
    auto const moved = static_cast<std::size_t>(options_.moved_points);
    for (std::size_t i = 0; i < std::min(moved, map.local.size()); ++i) {
      stand_in::map_point& p = *map.local[i];
      Eigen::Vector3f const P = p.GetWorldPos();
      float const sign = id_ % 20 < 10 ? 1.0f : -1.0f;
      p.SetWorldPos(P * (1 + sign * 1e-5f));
      p.set_view(P.normalized(), P.norm() * 0.3f, P.norm() * 2);
    }
  }

  live_options options_;
  ft::orbslam3::settings settings_;
  accelerator gpu_;
  push_changes hooks_;
  stand_in::matrix left_[2];
  stand_in::matrix right_[2];
  unsigned long id_ = 0;
  std::size_t oldest_ = 0;
  bool counted_ = false;
  double sum_ = 0;
  int keypoints_ = 0;
  long matches_ = 0, inliers_ = 0, in_view_ = 0;
  std::map<std::string, std::vector<double>> totals_;
};

/// Runs, and prints the times of the calls.
/// @param make a device for settings
template <typename Make>
nlohmann::json run_live(live_options const& o, Make const& make) {
  live_run calls(o, make(kitti()));
  calls.run();
  calls.print("calls", calls.totals());
  nlohmann::json out{{"facts", calls.facts()}};
  for (auto const& [name, v] : calls.totals()) {
    nlohmann::json& j = out["total"][name];
    j = {{"p50", live_run::quantile(v, 0.5)},
         {"p90", live_run::quantile(v, 0.9)},
         {"p99", live_run::quantile(v, 0.99)},
         {"max", live_run::quantile(v, 1)}};
    if (o.samples) { j["samples"] = v; }
  }
  std::printf("%s\n", out["facts"].dump().c_str());
  return out;
}

}  // namespace bench

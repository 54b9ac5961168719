// SPDX-License-Identifier: Apache-2.0
/// @file Frustum and searches as loops over the stand-in types, read off sections 7 to 10 of
/// docs/reference_behaviour.md: what a system's own CPU code does. The oracle of the shim's tests,
/// and the CPU's side where both are mixed or compared.
#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <bitset>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

class plain_search {
public:
  explicit plain_search(ft::orbslam3::settings const& s) : s_(s) {
    scale_.push_back(1.0f);
    for (int l = 1; l < s.levels; ++l) { scale_.push_back(scale_.back() * s.scale_factor); }
  }

  /// Section 12; pixels.
  static Eigen::Vector2f project(ft::orbslam3::camera_parameters const& c,
                                 Eigen::Vector3f const& P) {
    float const* const v = c.values;
    if (c.kind == ft::orbslam3::lens::pinhole) {
      return {v[0] * P.x() / P.z() + v[2], v[1] * P.y() / P.z() + v[3]};
    }
    float const radius = std::sqrt(P.x() * P.x() + P.y() * P.y());
    auto const theta =
        static_cast<float>(std::atan2(static_cast<double>(radius), static_cast<double>(P.z())));
    float const t2 = theta * theta;
    float const t3 = theta * t2;
    float const t5 = t3 * t2;
    float const t7 = t5 * t2;
    float const t9 = t7 * t2;
    float const r = theta + v[4] * t3 + v[5] * t5 + v[6] * t7 + v[7] * t9;
    return {v[0] * r * (P.x() / radius) + v[2], v[1] * r * (P.y() / radius) + v[3]};
  }

  /// Section 8 for one point; returns whether a camera sees it.
  bool in_frustum(stand_in::frame const& f, stand_in::map_point& p) const {
    p.mbTrackInView = p.mbTrackInViewR = false;
    stand_in::se3 const T_wc = f.GetPose().inverse();
    sight const left = see(f, p, {R(f), t(f), T_wc.translation()}, s_.left);
    if (left.level >= 0) {
      p.mbTrackInView = true;
      p.mTrackProjX = left.x;
      p.mTrackProjY = left.y;
      p.mTrackDepth = left.distance;
      p.mnTrackScaleLevel = left.level;
      p.mTrackViewCos = left.cosine;
      if (f.Nleft == -1) { p.mTrackProjXR = left.x - s_.bf * (1.0f / left.z); }
    }
    if (f.Nleft == -1) { return p.mbTrackInView; }
    Eigen::Matrix3f const R_rw = R_rl() * R(f);
    Eigen::Vector3f const t_rw = R_rl() * t(f) + t_rl();
    Eigen::Vector3f const right_centre =
        T_wc.rotationMatrix() * f.T_lr.translation() + T_wc.translation();
    sight const right = see(f, p, {R_rw, t_rw, right_centre}, s_.right);
    if (right.level >= 0) {
      p.mbTrackInViewR = true;
      p.mTrackProjXR = right.x;
      p.mTrackProjYR = right.y;
      p.mTrackDepthR = right.distance;
      p.mnTrackScaleLevelR = right.level;
      p.mTrackViewCosR = right.cosine;
    }
    return p.mbTrackInView || p.mbTrackInViewR;
  }

  /// Frustum of all points that were not seen, then section 9 where one is in view.
  int search_local(stand_in::frame& f, std::vector<stand_in::map_point*> const& points, float th,
                   bool far_points = false, float far_threshold = 50) const {
    int in_view = 0;
    for (auto* p : points) {
      if (p->mnLastFrameSeen == f.mnId || p->isBad()) { continue; }
      if (!in_frustum(f, *p)) { continue; }
      ++in_view;
      p->IncreaseVisible(1);
      if (p->mbTrackInView) {
        f.mmProjectPoints[p->mnId] = stand_in::point2f(p->mTrackProjX, p->mTrackProjY);
      }
    }
    if (in_view == 0) { return 0; }
    cells const left(f, keys(f, 0));
    cells const right(f, f.mvKeysRight);
    int matches = 0;
    for (auto* p : points) {
      if (p->isBad() || (!p->mbTrackInView && !p->mbTrackInViewR)) { continue; }
      if (far_points && p->mTrackDepth > far_threshold) { continue; }
      bool refused = false;
      if (p->mbTrackInView) {
        float const factor = (static_cast<double>(p->mTrackViewCos) > 0.998 ? 2.5f : 4.0f) * th;
        matches += take(f, *p, 0, left, p->mTrackProjX, p->mTrackProjY, p->mTrackProjXR,
                        factor * scale(p->mnTrackScaleLevel), p->mnTrackScaleLevel, refused);
      }
      if (!refused && f.Nleft != -1 && p->mbTrackInViewR) {
        float const factor = static_cast<double>(p->mTrackViewCosR) > 0.998 ? 2.5f : 4.0f;
        matches += take(f, *p, 1, right, p->mTrackProjXR, p->mTrackProjYR, 0,
                        factor * scale(p->mnTrackScaleLevelR), p->mnTrackScaleLevelR, refused);
      }
    }
    return matches;
  }

  /// Section 10, without the repetition.
  int search_last(stand_in::frame& f, stand_in::frame const& last, float th, bool mono) const {
    bool const two = f.Nleft != -1;
    cells const left(f, keys(f, 0));
    cells const right(f, f.mvKeysRight);
    Eigen::Vector3f const centre = f.GetPose().inverse().translation();
    float const ahead = (R(last) * centre + t(last)).z();
    float const baseline = two ? t_rl().norm() : s_.bf / s_.left.values[0];
    bool const forward = !mono && ahead > baseline;
    bool const backward = !mono && -ahead > baseline;
    std::vector<rotated> taken;
    for (int i = 0; i < last.N; ++i) {
      auto* const p = last.mvpMapPoints[static_cast<std::size_t>(i)];
      if (p == nullptr || last.mvbOutlier[static_cast<std::size_t>(i)]) { continue; }
      Eigen::Vector3f const Pc = f.GetPose() * p->GetWorldPos();
      float const inv_z = 1.0f / Pc.z();
      if (!(inv_z >= 0)) { continue; }
      auto const uv = project(s_.left, Pc);
      if (!inside(f, uv)) { continue; }
      bool const from_right = last.Nleft != -1 && i >= last.Nleft;
      auto const& from = from_right ? last.mvKeysRight[static_cast<std::size_t>(i - last.Nleft)]
                                    : keys(last, 0)[static_cast<std::size_t>(i)];
      float const radius = th * scale(from.octave);
      int const low = forward ? from.octave : backward ? 0 : from.octave - 1;
      int const high = forward ? -1 : backward ? from.octave : from.octave + 1;
      auto const candidates = left.area(uv.x(), uv.y(), radius, low, high);
      if (candidates.empty()) { continue; }
      nearest(f, *p, 0, candidates, uv.x() - s_.bf * inv_z, radius, from.angle, taken);
      if (!two) { continue; }
      Eigen::Vector3f const Pr = R_rl() * Pc + t_rl();
      auto const at = project(s_.reference_quirks ? s_.left : s_.right, Pr);
      nearest(f, *p, 1, right.area(at.x(), at.y(), radius, low, high), 0, radius, from.angle,
              taken);
    }
    return static_cast<int>(taken.size()) - drop_rotated(f, taken);
  }

protected:
  struct sight {
    float x, y, z, distance, cosine;
    int level;
  };
  struct rotated {
    std::size_t index;
    int bin;
  };

  static Eigen::Matrix3f R(stand_in::frame const& f) { return f.GetPose().rotationMatrix(); }
  static Eigen::Vector3f t(stand_in::frame const& f) { return f.GetPose().translation(); }
  Eigen::Matrix3f R_rl() const {
    Eigen::Matrix3f m;
    for (int i = 0; i < 9; ++i) { m(i / 3, i % 3) = s_.T_rl.R.m[i]; }
    return m;
  }
  Eigen::Vector3f t_rl() const { return {s_.T_rl.t.x, s_.T_rl.t.y, s_.T_rl.t.z}; }
  float scale(int level) const { return scale_[static_cast<std::size_t>(level)]; }
  static std::vector<stand_in::keypoint> const& keys(stand_in::frame const& f, int camera) {
    return camera == 1 ? f.mvKeysRight : f.Nleft != -1 ? f.mvKeys : f.mvKeysUn;
  }
  static bool inside(stand_in::frame const& f, Eigen::Vector2f const& uv) {
    return uv.x() >= f.mnMinX && uv.x() <= f.mnMaxX && uv.y() >= f.mnMinY && uv.y() <= f.mnMaxY;
  }
  struct viewpoint {
    Eigen::Matrix3f R_cw;
    Eigen::Vector3f t_cw;
    Eigen::Vector3f centre;
  };
  sight see(stand_in::frame const& f, stand_in::map_point& p, viewpoint const& from,
            ft::orbslam3::camera_parameters const& camera) const {
    sight const none{0, 0, 0, 0, 0, -1};
    Eigen::Vector3f const P = p.GetWorldPos();
    Eigen::Vector3f const Pc = from.R_cw * P + from.t_cw;
    if (!(Pc.z() >= 0)) { return none; }
    auto const uv = project(camera, Pc);
    if (!inside(f, uv)) { return none; }
    Eigen::Vector3f const view = P - from.centre;
    float const distance = view.norm();
    if (distance < p.GetMinDistanceInvariance() || distance > p.GetMaxDistanceInvariance()) {
      return none;
    }
    float const cosine = view.dot(p.GetNormal()) / distance;
    if (!(cosine >= 0.5f)) { return none; }
    float const ratio = p.raw_max_distance() / distance;
    int const level = static_cast<int>(std::ceil(std::log(ratio) / std::log(s_.scale_factor)));
    return {uv.x(), uv.y(), Pc.z(), Pc.norm(), cosine, std::clamp(level, 0, s_.levels - 1)};
  }

  /// Section 7.
  struct cells {
    cells(stand_in::frame const& f, std::vector<stand_in::keypoint> const& all)
        : min_x(f.mnMinX),
          min_y(f.mnMinY),
          inv_x(64.0f / (f.mnMaxX - f.mnMinX)),
          inv_y(48.0f / (f.mnMaxY - f.mnMinY)),
          keypoints(all),
          lists(64 * 48) {
      for (std::size_t i = 0; i < all.size(); ++i) {
        int const x = static_cast<int>(std::round((all[i].pt.x - min_x) * inv_x));
        int const y = static_cast<int>(std::round((all[i].pt.y - min_y) * inv_y));
        if (x >= 0 && x < 64 && y >= 0 && y < 48) { at(x, y).push_back(i); }
      }
    }
    std::vector<std::size_t>& at(int x, int y) {
      return lists[static_cast<std::size_t>(x * 48 + y)];
    }
    std::vector<std::size_t> const& at(int x, int y) const {
      return lists[static_cast<std::size_t>(x * 48 + y)];
    }
    std::vector<std::size_t> area(float x, float y, float r, int low, int high) const {
      std::vector<std::size_t> found;
      int const x0 = std::max(0, static_cast<int>(std::floor((x - min_x - r) * inv_x)));
      int const x1 = std::min(63, static_cast<int>(std::ceil((x - min_x + r) * inv_x)));
      int const y0 = std::max(0, static_cast<int>(std::floor((y - min_y - r) * inv_y)));
      int const y1 = std::min(47, static_cast<int>(std::ceil((y - min_y + r) * inv_y)));
      for (int cx = x0; cx <= x1; ++cx) {
        for (int cy = y0; cy <= y1; ++cy) {
          for (std::size_t const i : at(cx, cy)) {
            auto const& k = keypoints[i];
            if (k.octave < low || (high >= 0 && k.octave > high)) { continue; }
            if (std::abs(k.pt.x - x) < r && std::abs(k.pt.y - y) < r) { found.push_back(i); }
          }
        }
      }
      return found;
    }
    float min_x, min_y, inv_x, inv_y;
    std::vector<stand_in::keypoint> const& keypoints;
    std::vector<std::vector<std::size_t>> lists;
  };

  static std::size_t index(stand_in::frame const& f, int camera, std::size_t k) {
    return camera == 0 ? k : static_cast<std::size_t>(f.Nleft) + k;
  }
  static unsigned char const* descriptor(stand_in::frame const& f, int camera, std::size_t k) {
    bool const joined = camera == 1 && f.mDescriptors.rows == f.N;
    auto const& m = camera == 0 || joined ? f.mDescriptors : f.mDescriptorsRight;
    std::size_t const row = joined ? index(f, 1, k) : k;
    return m.data + row * static_cast<std::size_t>(m.step);
  }
  static int hamming(unsigned char const* a, unsigned char const* b) {
    int bits = 0;
    for (int i = 0; i < 32; ++i) {
      bits += static_cast<int>(std::bitset<8>(static_cast<unsigned char>(a[i] ^ b[i])).count());
    }
    return bits;
  }
  static bool occupied(stand_in::frame const& f, std::size_t i) {
    return f.mvpMapPoints[i] != nullptr && f.mvpMapPoints[i]->Observations() > 0;
  }
  bool wrong_column(stand_in::frame const& f, int camera, std::size_t k, float right_x,
                    float radius) const {
    if (camera != 0 || k >= f.mvuRight.size() || f.Nleft != -1) { return false; }
    return f.mvuRight[k] > 0 && std::abs(right_x - f.mvuRight[k]) > radius;
  }

  /// A local map's point in one camera.
  int take(stand_in::frame& f, stand_in::map_point& p, int camera, cells const& grid, float x,
           float y, float right_x, float radius, int level, bool& refused) const {
    auto const wanted = p.GetDescriptor();
    int best = 256, second = 256, best_octave = -1, second_octave = -1;
    std::size_t best_k = 0;
    for (std::size_t const k : grid.area(x, y, radius, level - 1, level)) {
      if (occupied(f, index(f, camera, k)) || wrong_column(f, camera, k, right_x, radius)) {
        continue;
      }
      int const distance = hamming(wanted.data, descriptor(f, camera, k));
      int const octave = keys(f, camera)[k].octave;
      if (distance < best) {
        second = best;
        second_octave = best_octave;
        best = distance;
        best_octave = octave;
        best_k = k;
      } else if (distance < second) {
        second = distance;
        second_octave = octave;
      }
    }
    if (best > 100) { return 0; }
    if (best_octave == second_octave &&
        static_cast<float>(best) > 0.8f * static_cast<float>(second)) {
      refused = camera == 0;
      return 0;
    }
    f.mvpMapPoints[index(f, camera, best_k)] = &p;
    if (f.Nleft == -1) { return 1; }
    auto const& partners = camera == 0 ? f.mvLeftToRightMatch : f.mvRightToLeftMatch;
    int const partner = best_k < partners.size() ? partners[best_k] : -1;
    if (partner < 0) { return 1; }
    f.mvpMapPoints[index(f, 1 - camera, static_cast<std::size_t>(partner))] = &p;
    return 2;
  }

  /// A last frame's point in one camera.
  void nearest(stand_in::frame& f, stand_in::map_point& p, int camera,
               std::vector<std::size_t> const& candidates, float right_x, float radius, float angle,
               std::vector<rotated>& taken) const {
    auto const wanted = p.GetDescriptor();
    int best = 256;
    std::size_t best_k = 0;
    for (std::size_t const k : candidates) {
      if (occupied(f, index(f, camera, k)) || wrong_column(f, camera, k, right_x, radius)) {
        continue;
      }
      int const distance = hamming(wanted.data, descriptor(f, camera, k));
      if (distance < best) {
        best = distance;
        best_k = k;
      }
    }
    if (best > 100) { return; }
    f.mvpMapPoints[index(f, camera, best_k)] = &p;
    float rotation = angle - keys(f, camera)[best_k].angle;
    if (rotation < 0) { rotation += 360.0f; }
    int const bin = static_cast<int>(std::round(rotation * (1.0f / 30.0f)));
    taken.push_back({index(f, camera, best_k), bin == 30 ? 0 : bin});
  }
  static int drop_rotated(stand_in::frame& f, std::vector<rotated> const& taken) {
    int histogram[30] = {};
    for (rotated const& r : taken) { ++histogram[r.bin]; }
    int order[30];
    for (int i = 0; i < 30; ++i) { order[i] = i; }
    std::stable_sort(order, order + 30, [&](int a, int b) { return histogram[a] > histogram[b]; });
    auto const least = 0.1f * static_cast<float>(histogram[order[0]]);
    int kept = 1;
    if (static_cast<float>(histogram[order[1]]) >= least) {
      kept = static_cast<float>(histogram[order[2]]) >= least ? 3 : 2;
    }
    int dropped = 0;
    for (rotated const& r : taken) {
      if (std::find(order, order + kept, r.bin) != order + kept) { continue; }
      f.mvpMapPoints[r.index] = nullptr;
      ++dropped;
    }
    return dropped;
  }

  ft::orbslam3::settings s_;
  std::vector<float> scale_;
};

/// ORB-SLAM3's loop over the frame's own points, before the local map is searched.
inline void mark_own_points(stand_in::frame& f) {
  for (auto*& p : f.mvpMapPoints) {
    if (p == nullptr) { continue; }
    if (p->isBad()) {
      p = nullptr;
      continue;
    }
    p->IncreaseVisible(1);
    p->mnLastFrameSeen = f.mnId;
    p->mbTrackInView = p->mbTrackInViewR = false;
  }
}

}  // namespace orbslam3_test

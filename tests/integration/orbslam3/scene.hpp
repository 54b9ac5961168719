// SPDX-License-Identifier: Apache-2.0
/// @file Random scenes of the stand-in types, for every kind of sensor: map points, the last frame
/// that holds them and a current one that sees them again.
#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "integration/orbslam3/plain_types.hpp"
#include "tests/integration/orbslam3/constructors.hpp"
#include "tests/integration/orbslam3/plain_search.hpp"
#include "tests/integration/orbslam3/stand_in.hpp"

namespace orbslam3_test {

using stand_in::sensor;

inline char const* name_of(sensor s) {
  constexpr char const* names[] = {"stereo", "rgbd", "monocular", "fisheye_stereo",
                                   "fisheye_monocular"};
  return names[static_cast<int>(s)];
}
inline constexpr sensor all_sensors[] = {sensor::stereo, sensor::rgbd, sensor::monocular,
                                         sensor::fisheye_stereo, sensor::fisheye_monocular};

inline ft::orbslam3::settings settings_for(sensor kind) {
  using ft::orbslam3::lens;
  ft::orbslam3::settings s;
  bool const fisheye = kind == sensor::fisheye_stereo || kind == sensor::fisheye_monocular;
  s.width = 640;
  s.height = 480;
  s.features = 1000;
  s.images = kind == sensor::stereo || kind == sensor::fisheye_stereo ? 2 : 1;
  s.map_points = 4096;
  if (fisheye) {
    s.left = {lens::kannala_brandt, {280, 281, 322, 239, 0.003f, 0.0007f, -0.002f, 0.0002f}};
    s.right = {lens::kannala_brandt, {279, 280, 318, 241, 0.004f, 0.0006f, -0.0019f, 0.0001f}};
    Eigen::Matrix3f const R =
        Eigen::AngleAxisf(0.01f, Eigen::Vector3f(0.3f, 1, 0.2f).normalized()).toRotationMatrix();
    for (int i = 0; i < 9; ++i) { s.T_rl.R.m[i] = R(i / 3, i % 3); }
    s.T_rl.t.x = -0.1f;
  } else {
    s.left = {lens::pinhole, {458, 457, 317, 243}};
    s.bf = kind == sensor::monocular ? 0.0f : 0.11f * 458;
  }
  return s;
}

class scene {
public:
  ft::orbslam3::settings settings;
  std::vector<std::unique_ptr<stand_in::map_point>> map;
  stand_in::frame last;
  stand_in::frame current;

  /// @param points on the map @param unobserved share of points that nobody observes
  scene(sensor kind, unsigned seed, int points = 900, double unobserved = 0.05)
      : settings(settings_for(kind)), kind_(kind), random_(seed) {
    scale_.push_back(1);
    for (int l = 1; l < settings.levels; ++l) {
      scale_.push_back(scale_.back() * settings.scale_factor);
    }
    stand_in::se3 const T_lw = pose(0.05f, 0.05f);
    // Along the axis now and then, so that forward and backward are met.
    float const step = seed % 3 == 0 ? 0.02f : 0.25f;
    Eigen::Vector3f const move(number(-0.05f, 0.05f), number(-0.05f, 0.05f),
                               seed % 2 == 0 ? -step : step);
    stand_in::se3 const T_cw(rotation(0.02f) * T_lw.rotationMatrix(), T_lw.translation() + move);
    for (int i = 0; i < points; ++i) { add_point(T_lw, i, unobserved); }
    fill(last, 10, T_lw, true);
    fill(current, 11, T_cw, false);
    current.SetPose({rotation(0.002f) * T_cw.rotationMatrix(),
                     T_cw.translation() + Eigen::Vector3f(0.004f, -0.003f, 0.005f)});
  }

  /// All points, in an order of their own.
  std::vector<stand_in::map_point*> local_map() {
    std::vector<stand_in::map_point*> all;
    for (auto& p : map) { all.push_back(p.get()); }
    std::shuffle(all.begin(), all.end(), random_);
    return all;
  }
  float number(float low, float high) {
    return std::uniform_real_distribution<float>(low, high)(random_);
  }
  bool chance(double share) { return std::bernoulli_distribution(share)(random_); }
  std::vector<unsigned char> random_descriptor() {
    std::vector<unsigned char> d(32);
    for (auto& b : d) { b = static_cast<unsigned char>(random_()); }
    return d;
  }

private:
  bool two_cameras() const { return kind_ == sensor::fisheye_stereo; }
  Eigen::Matrix3f rotation(float angle) {
    Eigen::Vector3f const axis(number(-1, 1), number(-1, 1), number(-1, 1));
    return Eigen::AngleAxisf(number(-angle, angle), axis.normalized()).toRotationMatrix();
  }
  stand_in::se3 pose(float angle, float shift) {
    return {rotation(angle), Eigen::Vector3f(number(-shift, shift), number(-shift, shift), 0)};
  }

  void add_point(stand_in::se3 const& T_lw, int i, double unobserved) {
    auto p = std::make_unique<stand_in::map_point>();
    p->mnId = static_cast<unsigned long>(1000 + 3 * i);
    float const z = number(1.5f, 9.0f);
    Eigen::Vector3f const in_camera(number(-0.75f, 0.75f) * z, number(-0.55f, 0.55f) * z, z);
    Eigen::Vector3f const P = T_lw.rotationMatrix().transpose() * (in_camera - T_lw.translation());
    p->SetWorldPos(P);
    Eigen::Vector3f const centre = -(T_lw.rotationMatrix().transpose() * T_lw.translation());
    float const distance = (P - centre).norm();
    int const octave = static_cast<int>(random_() % static_cast<unsigned>(settings.levels));
    float const longest = distance * scale_[static_cast<std::size_t>(octave)] * number(0.85f, 1);
    Eigen::Vector3f const tilt(number(-0.5f, 0.5f), number(-0.5f, 0.5f), number(-0.5f, 0.5f));
    p->set_view(((P - centre) / distance + tilt).normalized(), longest / scale_.back(), longest);
    p->set_descriptor(random_descriptor().data());
    p->set_observations(chance(unobserved) ? 0 : 3);
    if (chance(0.02)) { p->SetBadFlag(); }
    map.push_back(std::move(p));
  }

  struct features {
    std::vector<stand_in::keypoint> keypoints;
    std::vector<std::vector<unsigned char>> descriptors;
    std::vector<stand_in::map_point*> points;
  };
  /// A keypoint at a pixel for `seen`, or one that belongs to nothing.
  void add_keypoint(features& to, Eigen::Vector2f const& pixel, stand_in::map_point* seen,
                    float distance) {
    stand_in::keypoint k;
    k.pt.x = pixel.x() + (seen == nullptr ? 0 : number(-2, 2));
    k.pt.y = pixel.y() + (seen == nullptr ? 0 : number(-2, 2));
    k.angle = seen == nullptr || chance(0.1)
                  ? number(0, 360)
                  : std::fmod(static_cast<float>(seen->mnId % 360) + number(0, 25), 360.0f);
    int octave = static_cast<int>(random_() % static_cast<unsigned>(settings.levels));
    auto bits = random_descriptor();
    if (seen != nullptr) {
      float const level = std::ceil(std::log(seen->raw_max_distance() / distance) / std::log(1.2f));
      octave = std::clamp(static_cast<int>(level) - static_cast<int>(random_() % 2), 0,
                          settings.levels - 1);
      auto const own = seen->GetDescriptor();
      std::memcpy(bits.data(), own.data, 32);
      for (int flips = static_cast<int>(random_() % 60); flips > 0; --flips) {
        bits[random_() % 32] ^= static_cast<unsigned char>(1u << random_() % 8);
      }
    }
    k.octave = octave;
    k.size = 31 * scale_[static_cast<std::size_t>(octave)];
    to.keypoints.push_back(k);
    to.descriptors.push_back(bits);
    to.points.push_back(seen);
  }
  features see(Eigen::Matrix3f const& R, Eigen::Vector3f const& t,
               ft::orbslam3::camera_parameters const& camera) {
    features all;
    for (auto& p : map) {
      Eigen::Vector3f const Pc = R * p->GetWorldPos() + t;
      auto const pixel = plain_search::project(camera, Pc);
      // Inside by more than the noise that is added.
      if (!(Pc.z() > 0 && pixel.x() > 3 && pixel.x() < 637 && pixel.y() > 3 && pixel.y() < 477)) {
        continue;
      }
      for (int again = 0; again < 2 && chance(0.8); ++again) {
        add_keypoint(all, pixel, p.get(), Pc.norm());
      }
    }
    for (int i = 0; i < 200; ++i) {
      add_keypoint(all, {number(0, 640), number(0, 480)}, nullptr, 0);
    }
    return all;
  }
  static stand_in::matrix rows(std::vector<std::vector<unsigned char>> const& all) {
    stand_in::matrix m;
    m.create(static_cast<int>(all.size()), 32, 0);
    for (std::size_t i = 0; i < all.size(); ++i) {
      std::memcpy(m.data + i * static_cast<std::size_t>(m.step), all[i].data(), 32);
    }
    return m;
  }

  void fill(stand_in::frame& f, unsigned long id, stand_in::se3 const& T_cw, bool held) {
    f.mnId = id;
    f.SetPose(T_cw);
    f.mnMaxX = 640;
    f.mnMaxY = 480;
    Eigen::Matrix3f const R = T_cw.rotationMatrix();
    Eigen::Vector3f const t = T_cw.translation();
    features left = see(R, t, settings.left);
    features right;
    if (two_cameras()) {
      Eigen::Matrix3f R_rl;
      for (int i = 0; i < 9; ++i) { R_rl(i / 3, i % 3) = settings.T_rl.R.m[i]; }
      Eigen::Vector3f const t_rl(settings.T_rl.t.x, settings.T_rl.t.y, settings.T_rl.t.z);
      right = see(R_rl * R, R_rl * t + t_rl, settings.right);
      f.T_lr = stand_in::se3(R_rl, t_rl).inverse();
    }
    f.mvKeysUn = left.keypoints;
    f.mvKeys = left.keypoints;
    if (kind_ == sensor::rgbd || kind_ == sensor::monocular) { distort(f); }
    f.mvKeysRight = right.keypoints;
    f.mDescriptors = rows(left.descriptors);
    f.mDescriptorsRight = rows(right.descriptors);
    f.N = static_cast<int>(left.keypoints.size());
    stand_in::set_no_pair(f);
    if (two_cameras()) {
      f.Nleft = f.N;
      f.Nright = static_cast<int>(right.keypoints.size());
      f.N += f.Nright;
      match(f, left, right);
    }
    if (settings.bf > 0) { add_right_columns(f, left, R, t); }
    f.mvpMapPoints.assign(static_cast<std::size_t>(f.N), nullptr);
    f.mvbOutlier.assign(static_cast<std::size_t>(f.N), false);
    if (!held) { return; }
    left.points.insert(left.points.end(), right.points.begin(), right.points.end());
    for (std::size_t i = 0; i < left.points.size(); ++i) {
      if (left.points[i] == nullptr || !chance(0.7)) { continue; }
      f.mvpMapPoints[i] = left.points[i];
      f.mvbOutlier[i] = chance(0.05);
    }
  }
  /// What the extractor saw, where searches use undistorted places.
  void distort(stand_in::frame& f) const {
    f.mnMinX = -12;
    f.mnMinY = -9;
    f.mnMaxX = 652;
    f.mnMaxY = 489;
    for (auto& k : f.mvKeys) {
      k.pt.x -= 0.02f * (k.pt.x - 320);
      k.pt.y -= 0.02f * (k.pt.y - 240);
    }
  }
  void match(stand_in::frame& f, features const& left, features const& right) {
    f.mvLeftToRightMatch.assign(left.points.size(), -1);
    f.mvRightToLeftMatch.assign(right.points.size(), -1);
    for (std::size_t i = 0; i < left.points.size(); ++i) {
      for (std::size_t j = 0; j < right.points.size() && left.points[i] != nullptr; ++j) {
        if (left.points[i] != right.points[j] || !chance(0.5)) { continue; }
        f.mvLeftToRightMatch[i] = static_cast<int>(j);
        f.mvRightToLeftMatch[j] = static_cast<int>(i);
        break;
      }
    }
  }
  void add_right_columns(stand_in::frame& f, features const& left, Eigen::Matrix3f const& R,
                         Eigen::Vector3f const& t) {
    f.mvuRight.assign(left.keypoints.size(), -1);
    f.mvDepth.assign(left.keypoints.size(), -1);
    for (std::size_t i = 0; i < left.keypoints.size(); ++i) {
      if (!chance(0.7)) { continue; }
      float const z =
          left.points[i] == nullptr ? number(1, 9) : (R * left.points[i]->GetWorldPos() + t).z();
      f.mvDepth[i] = z;
      f.mvuRight[i] = left.keypoints[i].pt.x - settings.bf / z + number(-1, 1);
    }
  }

  sensor kind_;
  std::mt19937 random_;
  std::vector<float> scale_;
};

}  // namespace orbslam3_test

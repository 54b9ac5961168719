// SPDX-License-Identifier: Apache-2.0
/// @file The recorded inputs of golden_words: cameras, frames, keyframes, and the node of a
/// vocabulary that each descriptor passes, which is found here by a plain descent.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/core/counter_draws.hpp"
#include "ft/types/poses.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"

namespace test {

/// The cases of a stage, in the order of their names.
inline std::vector<std::string> cases_of(std::string const& folder, std::string const& stage) {
  std::vector<std::string> found;
  for (auto const& entry : std::filesystem::directory_iterator(folder + "/" + stage)) {
    found.push_back(entry.path().string());
  }
  std::sort(found.begin(), found.end());
  return found;
}

inline nlohmann::json words_case(std::string const& folder) {
  std::ifstream file(folder + "/case.json");
  return nlohmann::json::parse(file);
}
inline ft::pose words_pose(std::string const& folder) {
  auto const m = read_npy<float>(folder + "/Tcw.npy");
  return {{{m(0, 0), m(0, 1), m(0, 2), m(1, 0), m(1, 1), m(1, 2), m(2, 0), m(2, 1), m(2, 2)}},
          {m(0, 3), m(1, 3), m(2, 3)}};
}
inline std::vector<ft::descriptor> words_descriptors(std::string const& file) {
  auto const bytes = read_npy<std::uint8_t>(file);
  std::vector<ft::descriptor> d(static_cast<std::size_t>(bytes.rows()));
  if (!d.empty()) { std::memcpy(d.data(), bytes.data.data(), bytes.data.size()); }
  return d;
}

/// A recorded frame: left keypoints, then right ones.
struct words_frame {
  std::vector<float> x, y, angle;  ///< x and y undistorted
  std::vector<int> octave;
  std::vector<ft::descriptor> orb;
  int left = 0;  ///< left keypoints
  int cameras = 1;
  std::string set;  ///< folder of its cameras

  words_frame(std::string const& root, std::string const& name) {
    std::string const at = root + "/frames/" + name;
    add(read_npy<float>(at + (exists(at + "/kpUn.npy") ? "/kpUn.npy" : "/kp.npy")));
    left = size();
    if (exists(at + "/kpR.npy")) {
      cameras = 2;
      add(read_npy<float>(at + "/kpR.npy"));
    }
    orb = words_descriptors(at + "/desc.npy");
    std::string const of = name.substr(0, name.rfind('_'));
    set = root + "/sets/" + of.substr(0, of.rfind("_ini"));
  }
  int size() const { return static_cast<int>(x.size()); }

private:
  void add(npy<float> const& kp) {
    for (int i = 0; i < kp.rows(); ++i) {
      x.push_back(kp(i, 0));
      y.push_back(kp(i, 1));
      angle.push_back(kp(i, 3));
      octave.push_back(static_cast<int>(kp(i, 5)));
    }
  }
};

/// Keypoints in an executor's memory, a batch entry for each camera.
template <typename Exec>
ft::keypoints<Exec::space> upload_keypoints(Exec const& exec, words_frame const& f) {
  ft::keypoints<Exec::space> kp(std::max(f.size(), 1), f.cameras);
  for (int c = 0; c < f.cameras; ++c) {
    auto const to = kp.view().slice(c);
    std::size_t const first = c == 0 ? 0 : static_cast<std::size_t>(f.left);
    int const n = c == 0 ? f.left : f.size() - f.left;
    auto const put = [&](auto* target, auto const& values) {
      ft::copy(exec, target, values.data() + first, static_cast<std::size_t>(n));
      exec.wait();
    };
    put(ft::array_of<ft::field::x>(to), f.x);
    put(ft::array_of<ft::field::y>(to), f.y);
    put(ft::array_of<ft::field::angle>(to), f.angle);
    put(ft::array_of<ft::field::octave>(to), f.octave);
    put(ft::array_of<ft::field::orb>(to), f.orb);
    ft::copy(exec, to.count, &n, 1);
    exec.wait();
  }
  return kp;
}

/// The map points of a keyframe, and which keypoint holds which.
struct words_keyframe {
  std::string frame;  ///< name of its frame
  std::vector<int> holder;
  ft::map_points<ft::memory_space::host> map;

  explicit words_keyframe(std::string const& at)
      : frame(words_case(at)["frame"].get<std::string>()),
        holder(read_npy<std::int32_t>(at + "/kf_mp.npy").data) {
    auto const xyz = read_npy<float>(at + "/mp_xyz.npy");
    auto const range = read_npy<float>(at + "/mp_dist_min_max.npy");
    auto const orb = words_descriptors(at + "/mp_desc.npy");
    map = ft::map_points<ft::memory_space::host>(std::max(xyz.rows(), 1));
    auto const m = map.view();
    for (int i = 0; i < xyz.rows(); ++i) {
      m.position(i) = {xyz(i, 0), xyz(i, 1), xyz(i, 2)};
      m.normal(i) = {0, 0, 1};
      m.min_distance(i) = range(i, 0);
      m.max_distance(i) = range(i, 1);
      m.orb(i) = orb[static_cast<std::size_t>(i)];
      m.observations(i) = 0;  // not recorded
    }
    *m.count = xyz.rows();
  }
};

/// A vocabulary as its rule or its arrays say.
class words_tree {
public:
  words_tree() = default;
  words_tree(std::string const& root, std::string const& name) : made_up_(name == "synth_k10_L6") {
    if (made_up_) { return; }
    std::string const at = root + "/vocabularies/" + name;
    levels_ = read_npy<std::int32_t>(at + "/k_L_scoring_weighting.npy")(1);
    auto const parent = read_npy<std::int32_t>(at + "/parent.npy");
    orb_ = words_descriptors(at + "/desc.npy");
    weight_ = read_npy<double>(at + "/weight.npy").data;
    children_.resize(orb_.size());
    for (int n = 1; n < parent.rows(); ++n) {
      children_[static_cast<std::size_t>(parent(n))].push_back(n);
    }
  }

  /// The node that a descriptor passes `up` levels above the words; -1 for a stop word.
  int group(ft::descriptor const& d, int up) const {
    int node = 0;
    int passed = 0;
    int depth = 0;
    for (auto next = children(0); !next.empty(); next = children(node)) {
      int best = 257;
      for (int const child : next) {
        int const distance = ft::hamming(d, descriptor_of(child));
        if (distance < best) {
          best = distance;
          node = child;
        }
      }
      if (++depth <= levels_ - up) { passed = node; }
    }
    return weight(node) > 0 ? passed : -1;
  }

private:
  static constexpr int first_leaf = 111111;

  std::vector<int> children(int node) const {
    if (!made_up_) { return children_[static_cast<std::size_t>(node)]; }
    std::vector<int> all;
    for (int j = 1; node < first_leaf && j <= 10; ++j) { all.push_back(10 * node + j); }
    return all;
  }
  ft::descriptor descriptor_of(int node) const {
    if (!made_up_) { return orb_[static_cast<std::size_t>(node)]; }
    std::uint64_t words[4] = {};
    for (int n = node; n > 0; n = (n - 1) / 10) {
      int const depth = depth_of(n);
      for (int i = 0; i < 4; ++i) {
        std::uint64_t all = ~std::uint64_t{0};
        for (int j = 0; j < depth; ++j) { all &= random(n, 8 * i + j); }
        words[i] ^= all;
      }
    }
    ft::descriptor d;
    std::memcpy(&d, words, sizeof d);
    return d;
  }
  double weight(int node) const {
    if (!made_up_) { return weight_[static_cast<std::size_t>(node)]; }
    std::uint64_t const r = random(node, 63);
    return r % 97 == 0 ? 0.0 : static_cast<double>(1 + (r >> 32) % 1024) / 128;
  }
  static int depth_of(int node) {
    int depth = 0;
    for (; node > 0; node = (node - 1) / 10) { ++depth; }
    return depth;
  }
  static std::uint64_t random(int node, int x) {
    return ft::counter_draws{12345}.bits(static_cast<std::uint64_t>(node), x);
  }

  bool made_up_ = false;
  int levels_ = 6;
  std::vector<ft::descriptor> orb_;
  std::vector<double> weight_;
  std::vector<std::vector<int>> children_;
};

}  // namespace test

// SPDX-License-Identifier: Apache-2.0
/// @file Inputs of the section `words` in an executor's memory.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstring>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "bench/runner.hpp"
#include "bench/words_scene.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/feature_grid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/map_points.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "ft/kernels/words/transform.hpp"
#include "ft/types/poses.hpp"

namespace bench {
inline namespace FT_ABI {
namespace words {

constexpr int inputs = words_runner::inputs;

inline std::size_t at(std::ptrdiff_t i) { return static_cast<std::size_t>(i); }

/// A bench that times a failure fails.
inline void require(bool found, char const* what) {
  if (!found) { throw std::runtime_error(std::string("words: ") + what); }
}

inline ft::descriptor descriptor_of(bits_256 const& from) {
  ft::descriptor d;
  static_assert(sizeof d == sizeof from, "the same layout");
  std::memcpy(d.words, from.words, sizeof d.words);
  return d;
}
inline std::vector<ft::descriptor> descriptors_of(std::vector<bits_256> const& from) {
  std::vector<ft::descriptor> to;
  to.reserve(from.size());
  for (auto const& d : from) { to.push_back(descriptor_of(d)); }
  return to;
}

/// Waits.
template <typename Exec, typename T>
void put(Exec const& exec, T* to, std::vector<T> const& from) {
  ft::copy(exec, to, from.data(), from.size());
  exec.wait();
}
template <typename Exec, typename T>
ft::buffer<T, Exec::space> moved(Exec const& exec, std::vector<T> const& from) {
  ft::buffer<T, Exec::space> to(from.size());
  put(exec, to.data(), from);
  return to;
}
template <typename Exec, typename T>
auto read(Exec const& exec, T* from, int count) {
  std::vector<std::remove_const_t<T>> to(at(count));
  ft::copy(exec, to.data(), static_cast<T const*>(from), to.size());
  exec.wait();
  return to;
}
template <typename Exec>
void put(Exec const& exec, ft::keypoints_view const& to, drawn_image const& from) {
  put(exec, ft::array_of<ft::field::x>(to), from.x);
  put(exec, ft::array_of<ft::field::y>(to), from.y);
  put(exec, ft::array_of<ft::field::angle>(to), from.angle);
  put(exec, ft::array_of<ft::field::octave>(to), from.octave);
  put(exec, ft::array_of<ft::field::orb>(to), descriptors_of(from.orb));
  put(exec, to.count, std::vector<int>{from.size()});
}

/// A view with the arrays of an owner that lives as long.
template <typename View, typename Exec, typename... Sizes>
ft::owner<View, Exec::space> make(Exec const&, Sizes const&... sizes) {
  return ft::owner<View, Exec::space>([&](ft::carver& c, View& v) { carve(c, v, sizes...); });
}

/// The vocabulary of a tree, and memory for the words of frames of 1200 keypoints.
template <typename Exec>
struct transformer {
  ft::vocabulary<Exec::space> vocabulary;
  ft::transform_params params;
  ft::owner<ft::frame_words_view, Exec::space> out;
  ft::owner<ft::transform_workspace, Exec::space> work;

  transformer(Exec const& exec, drawn_tree const& tree, int frames)
      : out(make<ft::frame_words_view>(exec, frames, drawn_place::features)),
        work(make<ft::transform_workspace>(exec, frames, drawn_place::features)) {
    auto const nodes = static_cast<int>(tree.parent.size());
    auto const orb = descriptors_of(tree.orb);
    ft::vocabulary_header header;
    header.branching = drawn_tree::branching;
    header.levels = tree.levels;
    vocabulary = ft::upload(exec, ft::make_vocabulary({header,
                                                       {tree.parent.data(), nodes},
                                                       {orb.data(), nodes},
                                                       {tree.weight.data(), nodes},
                                                       {tree.word.data(), nodes}})
                                      .view());
    params.levels_up = tree.levels - 2;  // a hundred groups
  }
  void queue(Exec const& exec, ft::descriptors_view const& in) const {
    ft::transform_to_words(exec, vocabulary.view(), in, params, out.view(), work.view());
  }
};

/// Frames at places of which they have keyframes; row `count * i + k` is keyframe k of frame i.
template <typename Exec>
struct places {
  static constexpr int features = drawn_place::features;
  /// Points of the last keyframe that the frame sees.
  static constexpr int seen = 70;

  int count;  ///< keyframes of a frame
  int slots;  ///< of a frame's map
  ft::keypoints<Exec::space> frames{features, inputs};
  ft::keypoints<Exec::space> keyframes;
  ft::map_points<Exec::space> map;
  ft::owner<ft::frame_words_view, Exec::space> frame_words, keyframe_words;
  ft::buffer<int, Exec::space> holder, row, frame_row;

  places(Exec const& exec, words_case const& what)
      : count(what.count),
        slots(features + count * drawn_place::held),
        keyframes(features, inputs * count),
        map(slots, inputs) {
    drawn_tree const& tree = drawn_tree::of(what.levels);
    std::vector<int> holders;
    std::vector<int> rows;
    std::vector<int> frame_rows;
    for (int i = 0; i < inputs; ++i) {
      drawn_place const place = draw_place(tree, count, seen, static_cast<unsigned>(i));
      put(exec, frames.view().slice(i), place.frame);
      put_points(exec, map.view().slice(i), place.points);
      for (int k = 0; k < count; ++k) {
        rows.push_back(count * i + k);
        frame_rows.push_back(i);
        put(exec, keyframes.view().slice(rows.back()), place.keyframes[at(k)]);
        holders.insert(holders.end(), place.holder[at(k)].begin(), place.holder[at(k)].end());
      }
    }
    holder = moved(exec, holders);
    row = moved(exec, rows);
    frame_row = moved(exec, frame_rows);
    transformer<Exec> of_keyframes(exec, tree, inputs * count);
    of_keyframes.queue(exec, keyframes.view());
    transformer<Exec> of_frames(exec, tree, inputs);
    of_frames.queue(exec, frames.view());
    exec.wait();
    keyframe_words = std::move(of_keyframes.out);
    frame_words = std::move(of_frames.out);
  }
  ft::word_keypoints_view frame_keypoints() const { return of(frames.view(), frame_words->groups); }
  ft::word_keypoints_view keyframe_keypoints() const {
    return of(keyframes.view(), keyframe_words->groups);
  }

private:
  static ft::word_keypoints_view of(ft::keypoints_view const& keypoints,
                                    ft::node_groups_view const& groups) {
    return {groups, ft::array_of<ft::field::orb>(keypoints),
            ft::array_of<ft::field::angle>(keypoints), nullptr};
  }
  static void put_points(Exec const& exec, ft::map_points_view const& to,
                         std::vector<drawn_point> const& from) {
    ft::map_points<ft::memory_space::host> const host(to.capacity);
    ft::map_points_view const v = host.view();
    ft::fill(ft::host_exec(1), v, 0);
    for (std::size_t k = 0; k < from.size(); ++k) {
      int const s = static_cast<int>(k);
      v.position(s) = {from[k].x, from[k].y, from[k].z};
      v.min_distance(s) = from[k].min_distance;
      v.max_distance(s) = from[k].max_distance;
      v.orb(s) = descriptor_of(from[k].orb);
      v.observations(s) = 2;
    }
    *v.count = static_cast<int>(from.size());
    ft::copy(exec, to, v);
    exec.wait();
  }
};

inline ft::rectified_rig rig() {
  using camera = drawn_camera;
  return ft::rectified_rig::make({camera::focal, camera::focal, camera::cx, camera::cy}, 0.11);
}
/// Whether a pose is that of draw_place(), within metres.
inline bool is_place(ft::pose const& T_cw, float within) {
  ft::vec3<float> const off = T_cw.inverse().t - ft::vec3<float>{0.3f, -0.2f, 0.5f};
  return std::sqrt(dot(off, off)) < within;
}

/// A pair of frames of one camera, for each input.
template <typename Exec>
struct pairs {
  static constexpr int features = drawn_pair::features;

  ft::keypoints<Exec::space> first{features, inputs}, second{features, inputs};
  ft::grid_geometry grid = ft::grid_geometry::over(0, 0, drawn_camera::width, drawn_camera::height);
  std::vector<ft::vec2<float>> positions;  ///< of the first frames

  explicit pairs(Exec const& exec) {
    for (int i = 0; i < inputs; ++i) {
      drawn_pair const pair = draw_pair(static_cast<unsigned>(i));
      put(exec, first.view().slice(i), pair.first);
      put(exec, second.view().slice(i), pair.second);
      for (std::size_t k = 0; k < pair.first.x.size(); ++k) {
        positions.push_back({pair.first.x[k], pair.first.y[k]});
      }
    }
  }
};

}  // namespace words
}  // namespace FT_ABI
}  // namespace bench

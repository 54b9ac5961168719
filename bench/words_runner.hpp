// SPDX-License-Identifier: Apache-2.0
/// @file The runners of the section `words`, instantiated once per executor.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <stdexcept>
#include <string>
#include <type_traits>
#include <utility>
#include <vector>

#include "bench/camera_runner.hpp"
#include "bench/clock.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
#include "bench/words_scene.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/monocular/initial_matches.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "ft/kernels/two_view/reconstruct.hpp"
#include "ft/kernels/words/keyframe_rows.hpp"
#include "ft/kernels/words/query_database.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "ft/kernels/words/transform.hpp"
#include "ft/pipelines/monocular_start.hpp"
#include "ft/pipelines/relocalizer.hpp"

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

template <typename Exec>
class transform_stage {
public:
  transform_stage(Exec const& exec, words_case const& what)
      : tree_(drawn_tree::of(what.levels)),
        frames_(what.count),
        words_(exec, tree_, frames_),
        in_(drawn_place::features, inputs * frames_) {
    for (int i = 0; i < inputs; ++i) {
      drawn_.push_back(descriptors_of(draw_descriptors(tree_, size(), static_cast<unsigned>(i))));
      put(exec, ft::array_of<ft::field::orb>(in_.view()) + i * std::ptrdiff_t{size()},
          drawn_.back());
    }
    put(exec, in_.view().count, std::vector<int>(at(inputs * frames_), drawn_place::features));
  }
  void before(Exec const&, int) {}
  void queue(Exec const& exec, int i) {
    ft::descriptors_view in = in_.view().slice(i * frames_);
    in.batch = frames_;
    words_.queue(exec, in);
  }
  int found(Exec const& exec, int i) const {
    ft::frame_words_view const& out = words_.out.view();
    auto const word = read(exec, out.features.word, size());
    for (int k = 0; k < size(); k += 37) {
      int const leaf = leaf_of(drawn_[at(i)][at(k)]);
      require(word[at(k)] == static_cast<std::uint32_t>(tree_.word[at(leaf)]), "a wrong word");
    }
    auto const count = read(exec, out.bag.count, frames_);
    for (int const n : count) { require(n > drawn_place::features / 2, "few words"); }
    return count.back();
  }

private:
  int size() const { return frames_ * drawn_place::features; }
  /// The plain way down the tree, whose nodes are in breadth-first order.
  int leaf_of(ft::descriptor const& d) const {
    int node = 0;
    while (tree_.word[at(node)] < 0) {
      int best = 257;
      int nearest = 0;
      for (int k = 1; k <= drawn_tree::branching; ++k) {
        int const child = drawn_tree::branching * node + k;
        int const distance = ft::hamming(d, descriptor_of(tree_.orb[at(child)]));
        if (distance < best) { nearest = child; }
        best = distance < best ? distance : best;
      }
      node = nearest;
    }
    return node;
  }

  drawn_tree const& tree_;
  int frames_;
  transformer<Exec> words_;
  ft::soa<Exec::space, ft::field::orb> in_;
  std::vector<std::vector<ft::descriptor>> drawn_;
};

template <typename Exec>
class query_stage {
public:
  query_stage(Exec const& exec, words_case const& what)
      : keyframes_(what.count), words_(words_of(what.levels)) {
    ft::keyframe_database_view sizes;
    sizes.capacity = keyframes_;
    sizes.row = bag_capacity;
    sizes.vocabulary = words_;
    database_ = ft::owner<ft::keyframe_database_view, Exec::space>(
        [](ft::carver& c, auto& v) { carve(c, v); }, sizes);
    queries_ = make<ft::word_list_view>(exec, inputs, bag_capacity);
    work_ = make<ft::query_workspace>(exec, 1, database_.view());
    found_ = make<ft::place_candidates_view>(exec, 1, keyframes_);
    map_ = moved(exec, std::vector<int>{0});
    clear(exec, database_.view());
    fill(exec);
    for (int i = 0; i < inputs; ++i) {
      put_bag(exec, query(i), draw_query_bag(words_, place(i), static_cast<unsigned>(i)));
    }
  }
  void before(Exec const&, int) {}
  void queue(Exec const& exec, int i) {
    query_database(exec, {query(i), map_.data()}, database_.view(), ft::word_scoring::l1,
                   found_.view(), work_.view());
  }
  int found(Exec const& exec, int i) const {
    int const count = read(exec, found_->count, 1)[0];
    bool there = false;
    for (auto const& c : read(exec, found_->of, count)) {
      there = there || std::abs(c.keyframe.slot - place(i)) <= 1;
    }
    require(there, "the query does not find its place");
    return count;
  }

private:
  static int words_of(int levels) {
    int words = 1;
    for (int l = 0; l < levels; ++l) { words *= drawn_tree::branching; }
    return words;
  }
  int place(int i) const { return (keyframes_ / 10 + i * keyframes_ / inputs) % keyframes_; }
  ft::word_list_view query(int i) const {
    ft::word_list_view v = queries_.view();
    return {1, v.capacity, v.count + i, v.word + v.at(i), v.value + v.at(i)};
  }
  static void put_bag(Exec const& exec, ft::word_list_view const& to, drawn_bag const& from) {
    put(exec, to.count, std::vector<int>{static_cast<int>(from.word.size())});
    put(exec, to.word, from.word);
    put(exec, to.value, from.value);
  }
  /// Keyframes in a row, each with the ten nearest ones as neighbours.
  void fill(Exec const& exec) {
    ft::keyframe_slots slots(keyframes_);
    std::vector<ft::keyframe_id> ids;
    for (int k = 0; k < keyframes_; ++k) {
      ids.push_back(slots.take());
      require(ids.back().slot == k, "slots are not in order");
      put_bag(exec, query(0), draw_keyframe_bag(words_, k));
      insert_keyframe(exec, query(0), {ids.back(), 0, 0}, database_.view());
    }
    for (int k = 0; k < keyframes_; ++k) {
      ft::keyframe_neighbours near;
      for (int n = k - 5; n <= k + 5; ++n) {
        if (n != k && n >= 0 && n < keyframes_) { near.of[near.count++] = ids[at(n)]; }
      }
      set_neighbours(exec, ids[at(k)], near, database_.view());
    }
    exec.wait();
  }

  int keyframes_;
  int words_;
  ft::owner<ft::keyframe_database_view, Exec::space> database_;
  ft::owner<ft::word_list_view, Exec::space> queries_;
  ft::owner<ft::query_workspace, Exec::space> work_;
  ft::owner<ft::place_candidates_view, Exec::space> found_;
  ft::buffer<int, Exec::space> map_;
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

template <typename Exec>
class search_stage {
public:
  search_stage(Exec const& exec, words_case const& what)
      : of_(exec, what),
        out_(make<ft::word_matches_view>(exec, of_.count, drawn_place::features)),
        work_(make<ft::words_search_workspace>(exec, of_.count, drawn_place::features)) {}
  void before(Exec const&, int) {}
  void queue(Exec const& exec, int i) {
    ft::words_search search;
    search.keyframes = of_.keyframe_keypoints();
    search.holder = of_.holder.data();
    search.frames = of_.frame_keypoints();
    search.keyframe = of_.row.data() + i * of_.count;
    search.frame = of_.frame_row.data() + i * of_.count;
    search_by_words(exec, search, {}, out_.view(), work_.view());
  }
  /// The frame's keypoint k sees point k.
  int found(Exec const& exec, int) const {
    int right = 0;
    auto const match =
        read(exec, out_->match + (of_.count - 1) * std::ptrdiff_t{out_->capacity}, out_->capacity);
    for (std::size_t k = 0; k < match.size(); ++k) { right += at(match[k]) == k ? 1 : 0; }
    int const count = read(exec, out_->count + of_.count - 1, 1)[0];
    require(right >= 15 && 2 * right > count, "the search does not match the keyframe");
    return count;
  }

private:
  places<Exec> of_;
  ft::owner<ft::word_matches_view, Exec::space> out_;
  ft::owner<ft::words_search_workspace, Exec::space> work_;
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

template <typename Exec>
class solve_stage {
public:
  solve_stage(Exec const& exec, words_case const& what)
      : count_(what.count), memory_([&](ft::carver& c) {
          for (auto& p : problems_) { carve(c, p, count_, correspondences); }
          carve(c, out_, count_, correspondences);
          carve(c, work_, problems_[0], params_);
        }) {
    for (int i = 0; i < inputs; ++i) {
      auto const seed = static_cast<unsigned>(i);
      auto const place = draw_place(drawn_tree::of(what.levels), 1, places<Exec>::seen, seed);
      std::vector<std::uint64_t> seeds;
      for (int b = 0; b < count_; ++b) {
        seeds.push_back(at(count_ * i + b));
        put_problem(exec, place, problems_[i], b);
      }
      put(exec, problems_[i].seed, seeds);
      ft::pnp_rays(exec, rig().camera, problems_[i]);
    }
    exec.wait();
  }
  void before(Exec const&, int) {}
  void queue(Exec const& exec, int i) {
    ft::solve_pnp(exec, rig().camera, problems_[i], params_, out_, work_);
  }
  int found(Exec const& exec, int) const {
    int least = correspondences;
    for (auto const& r : read(exec, out_.result, count_)) {
      require(ft::has_pose(r.status) && is_place(r.T_cw, 0.3f), "a pose is not found");
      least = std::min(least, r.inliers);
    }
    return least;
  }

private:
  static constexpr int correspondences = 100;

  /// A fifth of the pixels see other points.
  static void put_problem(Exec const& exec, drawn_place const& place,
                          ft::pnp_problems_view const& to, int b) {
    std::vector<ft::vec2<float>> pixels;
    std::vector<ft::vec3<float>> points;
    std::vector<float> errors;
    for (int j = 0; j < correspondences; ++j) {
      int const k = (b * correspondences + j) % drawn_place::features;
      auto const& p = place.points[at(j % 5 == 0 ? (k + 37) % drawn_place::features : k)];
      float const sigma =
          std::pow(drawn_camera::scale, static_cast<float>(place.frame.octave[at(k)]));
      pixels.push_back({place.frame.x[at(k)], place.frame.y[at(k)]});
      points.push_back({p.x, p.y, p.z});
      errors.push_back(5.991f * sigma * sigma);
    }
    put(exec, to.count + b, std::vector<int>{correspondences});
    put(exec, to.pixel + to.at(b), pixels);
    put(exec, to.point + to.at(b), points);
    put(exec, to.max_error2 + to.at(b), errors);
  }

  int count_;
  ft::pnp_params params_;
  ft::pnp_problems_view problems_[inputs];
  ft::pnp_results_view out_;
  ft::pnp_workspace work_;
  ft::arena<Exec::space> memory_;
};

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

/// Points of a reconstruction of draw_pair().
inline int points_of(ft::two_view_result const& r) {
  ft::vec3<float> const moved{-0.3f, 0.03f, -0.04f};
  bool const made = r.status == ft::two_view_status::reconstructed;
  require(made && dot(r.T_21.t, moved) > 0.95f * std::sqrt(dot(moved, moved)),
          "two views make no reconstruction");
  return r.triangulated;
}

template <typename Exec>
class two_views_stage {
public:
  two_views_stage(Exec const& exec, words_case const&)
      : of_(exec),
        matches_(make<ft::initial_matches_view>(exec, of_.features, inputs)),
        out_(make<ft::two_view_reconstructions>(exec, 1, of_.features)),
        work_(make<ft::two_view_workspace>(exec, 1, of_.features, params_.samples)),
        camera_(moved(exec, std::vector<ft::pinhole<float>>{rig().camera})),
        seed_(moved(exec, std::vector<std::uint64_t>{5})) {
    ft::feature_grid<Exec::space> const grids(of_.grid, of_.features, inputs);
    auto const work = make<ft::initial_match_workspace>(exec, of_.features, of_.features, inputs);
    ft::build_grid<ft::nearest_cell>(exec, of_.second.view(), 0, 1, inputs, grids.view());
    put(exec, matches_->previous, of_.positions);
    search_initial_matches(exec, {of_.first.view(), of_.second.view(), grids.view()}, {},
                           matches_.view(), work.view());
    exec.wait();
  }
  void before(Exec const&, int) {}
  void queue(Exec const& exec, int i) {
    reconstruct_two_views(
        exec,
        {of_.first.view().slice(i), of_.second.view().slice(i),
         matches_->match + i * std::ptrdiff_t{of_.features}, camera_.data(), seed_.data()},
        params_, out_.view(), work_.view());
  }
  int found(Exec const& exec, int) const { return points_of(read(exec, out_->result, 1)[0]); }

private:
  pairs<Exec> of_;
  ft::two_view_params params_;  // 200 samples
  ft::owner<ft::initial_matches_view, Exec::space> matches_;
  ft::owner<ft::two_view_reconstructions, Exec::space> out_;
  ft::owner<ft::two_view_workspace, Exec::space> work_;
  ft::buffer<ft::pinhole<float>, Exec::space> camera_;
  ft::buffer<std::uint64_t, Exec::space> seed_;
};

template <typename Exec>
class start_stage {
public:
  start_stage(Exec const& exec, words_case const&)
      : of_(exec), start_(exec, {}, {rig().camera}, of_.grid, of_.features) {}
  /// Attempts are counted again, so that samples are the same each time.
  void before(Exec const& exec, int i) {
    start_.restart(exec);
    add(exec, of_.first.view().slice(i));
  }
  void queue(Exec const& exec, int i) { add(exec, of_.second.view().slice(i)); }
  int found(Exec const& exec, int) const {
    auto const report = read(exec, start_.reports(), 1)[0];
    require(report.outcome == ft::start_outcome::started, "no start");
    return points_of(read(exec, start_.reconstructions().result, 1)[0]);
  }

private:
  void add(Exec const& exec, ft::keypoints_view const& frame) {
    start_.add(exec, {frame, frame, nullptr});
  }
  pairs<Exec> of_;
  ft::monocular_start<Exec> start_;
};

/// A stage with a recording for each input.
template <typename Exec, template <typename> class Stage>
class runner final : public words_runner {
public:
  explicit runner(words_case const& what) : owned_(1), stage_(owned_.exec, what) {
    for (int i = 0; i < inputs; ++i) {
      graph_[i].record(owned_.exec, [&](Exec const& exec) { stage_.queue(exec, i); });
    }
  }
  double run() override {
    last_ = (last_ + 1) % inputs;
    stage_.before(owned_.exec, last_);
    owned_.exec.wait();
    time_.begin(owned_.exec);
    graph_[last_].replay(owned_.exec, [&](Exec const& exec) { stage_.queue(exec, last_); });
    return time_.end(owned_.exec);
  }
  int found() override { return stage_.found(owned_.exec, last_); }

private:
  owned_executor<Exec> owned_;
  Stage<Exec> stage_;
  ft::recording<Exec> graph_[inputs];
  interval<Exec> time_;
  int last_ = inputs - 1;
};

/// The relocaliser waits for its steps, so it has no recording.
template <typename Exec>
class relocalize_runner final : public words_runner {
public:
  explicit relocalize_runner(words_case const& what)
      : owned_(1),
        of_(owned_.exec, what),
        relocalizer_(rig(), params(), {of_.features, of_.features, of_.slots, of_.count}),
        grids_(ft::grid_geometry::over(0, 0, drawn_camera::width, drawn_camera::height),
               of_.features, inputs),
        holder_(at(of_.features)) {
    ft::build_grid<ft::nearest_cell>(owned_.exec, of_.frames.view(), 0, 1, inputs, grids_.view());
    owned_.exec.wait();
  }
  double run() override {
    last_ = (last_ + 1) % inputs;
    auto const in = input();
    std::vector<int> rows;
    for (int k = 0; k < of_.count; ++k) { rows.push_back(last_ * of_.count + k); }
    double const start = now_us();
    result_ = relocalizer_.relocalize(owned_.exec, in, rows, 7);
    return now_us() - start;
  }
  int found() override {
    require(result_.found && result_.candidate == of_.count - 1, "the frame is not relocalised");
    require(is_place(result_.T_cw, 0.03f), "the frame is relocalised at a wrong place");
    // Words give about half of the points: the others are those of the searches.
    require(4 * result_.inliers > 3 * of_.seen, "points of the keyframe are not found");
    return result_.inliers;
  }

private:
  static ft::relocalization_params params() {
    ft::relocalization_params p;
    p.frustum.max_x = drawn_camera::width;
    p.frustum.max_y = drawn_camera::height;
    p.frustum.levels = drawn_camera::levels;
    p.frustum.log_scale_factor = ft::log_rounded(drawn_camera::scale);
    return p;
  }
  ft::relocalization_input input() const {
    ft::relocalization_input in;
    in.frame.keypoints = of_.frames.view().slice(last_);
    in.frame.keypoint_step = 1;
    in.frame.grids = grids_.view().slice(last_);
    in.frame.holder = holder_.data();
    in.map = of_.map.view().slice(last_);
    in.geometry = ft::pyramid_geometry::make(drawn_camera::width, drawn_camera::height,
                                             drawn_camera::levels, drawn_camera::scale);
    in.words = of_.frame_keypoints();
    ft::node_groups_view const all = in.words.groups;
    in.words.groups = {1,
                       all.capacity,
                       all.count + last_,
                       all.node + all.at(last_),
                       all.start + all.start_at(last_),
                       all.keypoint + all.at(last_)};
    in.words.orb += all.at(last_);
    in.words.angle += all.at(last_);
    in.keyframes = of_.keyframe_keypoints();
    in.keyframe_keypoints = of_.keyframes.view();
    in.holder = of_.holder.data();
    return in;
  }

  owned_executor<Exec> owned_;
  places<Exec> of_;
  ft::relocalizer<Exec, ft::rectified_rig> relocalizer_;
  ft::feature_grid<Exec::space> grids_;
  mutable ft::buffer<int, Exec::space> holder_;
  ft::relocalization result_;
  int last_ = inputs - 1;
};

}  // namespace words

template <typename Exec>
std::unique_ptr<words_runner> make_words_runner_of(words_case const& what) {
  switch (what.stage) {
    case words_stage::transform:
      return std::make_unique<words::runner<Exec, words::transform_stage>>(what);
    case words_stage::query:
      return std::make_unique<words::runner<Exec, words::query_stage>>(what);
    case words_stage::search:
      return std::make_unique<words::runner<Exec, words::search_stage>>(what);
    case words_stage::solve:
      return std::make_unique<words::runner<Exec, words::solve_stage>>(what);
    case words_stage::relocalize:
      return std::make_unique<words::relocalize_runner<Exec>>(what);
    case words_stage::two_views:
      return std::make_unique<words::runner<Exec, words::two_views_stage>>(what);
    case words_stage::start:
      return std::make_unique<words::runner<Exec, words::start_stage>>(what);
  }
  throw std::runtime_error("no such stage");
}

}  // namespace FT_ABI

std::unique_ptr<words_runner> make_host_words(words_case const& what);
std::unique_ptr<words_runner> make_cuda_words(words_case const& what);

}  // namespace bench

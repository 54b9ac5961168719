// SPDX-License-Identifier: Apache-2.0
/// @file The stages of the section `words`. Each has before(), which is not timed, queue(), and
/// found(), which checks what the last call wrote.
#pragma once

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "bench/runner.hpp"
#include "bench/words_inputs.hpp"
#include "bench/words_scene.hpp"
#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/two_views.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/monocular/initial_matches.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "ft/kernels/two_view/reconstruct.hpp"
#include "ft/kernels/words/query_database.hpp"
#include "ft/kernels/words/score.hpp"
#include "ft/kernels/words/search_by_words.hpp"
#include "ft/pipelines/monocular_start.hpp"

namespace bench {
inline namespace FT_ABI {
namespace words {

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

}  // namespace words
}  // namespace FT_ABI
}  // namespace bench

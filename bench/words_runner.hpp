// SPDX-License-Identifier: Apache-2.0
/// @file The runners of the section `words`, instantiated once per executor.
#pragma once

#include <memory>
#include <stdexcept>
#include <vector>

#include "bench/camera_runner.hpp"
#include "bench/clock.hpp"
#include "bench/owned_executor.hpp"
#include "bench/runner.hpp"
#include "bench/words_inputs.hpp"
#include "bench/words_scene.hpp"
#include "bench/words_stages.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/pipelines/relocalizer.hpp"

namespace bench {
inline namespace FT_ABI {
namespace words {

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

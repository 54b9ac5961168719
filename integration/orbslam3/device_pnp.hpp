// SPDX-License-Identifier: Apache-2.0
/// @file Poses by RANSAC on an executor: the memory of one problem and its launches.
#pragma once

#include <cstddef>
#include <cstdint>
#include <cstring>
#include <type_traits>

#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/kernels/pnp/problem.hpp"
#include "ft/kernels/pnp/solve_pnp.hpp"
#include "ft/types/poses.hpp"
#include "integration/orbslam3/call_clock.hpp"
#include "integration/orbslam3/own_stream.hpp"
#include "integration/orbslam3/recovery_types.hpp"
#include "integration/orbslam3/rigs.hpp"
#include "integration/orbslam3/word_mover.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

/// One problem at a time, whose state the caller keeps. On a stream of its own.
template <typename Exec, typename Camera>
class device_pnp {
  using state = std::remove_pointer_t<decltype(pnp_workspace::state)>;

public:
  /// Allocates memory, waits. @param keypoints most correspondences
  device_pnp(Exec const& beside, Camera const& camera, int keypoints)
      : stream_(beside), camera_(camera) {
    int const capacity = (keypoints + 3) / 4 * 4;  // flags are moved as words
    memory_ = arena<Exec::space>([&](carver& c) {
      carve(c, problem_, 1, capacity);
      carve(c, result_, 1, capacity);
      carve(c, work_, problem_, params_);
    });
    auto const n = static_cast<std::size_t>(capacity);
    host_memory_ = arena<staging_space<Exec>>([&](carver& c) {
      staged_.pixel = c.take<float>(2 * n);
      staged_.point = c.take<float>(3 * n);
      staged_.max_error2 = c.take<float>(n);
      seed_ = c.take<std::uint64_t>(1);
      state_ = c.take<state>(1);
      count_ = c.take<int>(1);
      answer_ = c.take<pnp_result>(1);
      inlier_ = c.take<std::uint32_t>(n / 4);
    });
    staged_.capacity = keypoints;
    std::memset(host_memory_.data(), 0, host_memory_.bytes());
    fill_bytes(exec(), memory_.data(), 0, memory_.bytes());
    exec().wait();
  }

  pnp_arrays& arrays() { return staged_; }
  void measure(bool on) { clock_.measure(on); }

  /// The next pose of what arrays() hold. Waits. @throws bad_argument, cuda_error
  pnp_found solve(pnp_progress& progress) {
    detail::require_range("correspondences of a pose", staged_.count, 0, staged_.capacity);
    detail::require_range("iterations of a pose", progress.done, 0, 1 << 30);
    if (staged_.count == 0) { return {false, true, {}, 0, nullptr, {}}; }
    clock_.mark(exec(), 0);
    send(progress);
    clock_.mark(exec(), 1);
    pnp_rays(exec(), camera_, problem_);
    continue_pnp(exec(), camera_, problem_, params_, result_, work_);
    clock_.mark(exec(), 2);
    fetch();
    clock_.mark(exec(), 3);
    exec().wait();
    progress.done = state_->done;
    progress.kept_inliers = state_->kept_inliers;
    std::memcpy(progress.kept, &state_->kept, sizeof progress.kept);
    return {has_pose(answer_->status),
            no_more(answer_->status),
            to_transform(answer_->T_cw),
            answer_->inliers,
            reinterpret_cast<unsigned char const*>(inlier_),
            clock_.read()};
  }

private:
  static_assert(sizeof(rigid<double>) == sizeof(pnp_progress::kept), "R by rows, then t");

  Exec const& exec() const { return stream_.exec(); }

  /// Hypotheses behind the iterations that are done may be another problem's: they are evaluated
  /// again, to the same bits.
  void send(pnp_progress const& progress) {
    int const n = staged_.count;
    *count_ = n;
    *seed_ = progress.seed;
    state_->done = state_->evaluated = progress.done;
    state_->kept_inliers = progress.kept_inliers;
    std::memcpy(static_cast<void*>(&state_->kept), progress.kept, sizeof progress.kept);
    word_mover<Exec> up;
    up.add(exec(), problem_.count, count_, 1);
    up.add(exec(), problem_.seed, seed_, 1);
    up.add(exec(), work_.state, state_, 1);
    up.add(exec(), reinterpret_cast<float*>(problem_.pixel), staged_.pixel, 2 * n);
    up.add(exec(), reinterpret_cast<float*>(problem_.point), staged_.point, 3 * n);
    up.add(exec(), problem_.max_error2, staged_.max_error2, n);
    up.flush(exec());
  }
  void fetch() {
    word_mover<Exec> down;
    down.add(exec(), answer_, result_.result, 1);
    down.add(exec(), state_, work_.state, 1);
    down.add(exec(), inlier_, reinterpret_cast<std::uint32_t const*>(result_.inlier),
             (staged_.count + 3) / 4);
    down.flush(exec());
  }

  own_stream<Exec> stream_;
  Camera camera_;
  call_clock<Exec> clock_;
  pnp_params params_;
  pnp_problems_view problem_;
  pnp_results_view result_;
  pnp_workspace work_;
  pnp_arrays staged_;
  std::uint64_t* seed_ = nullptr;
  state* state_ = nullptr;
  int* count_ = nullptr;
  pnp_result* answer_ = nullptr;
  std::uint32_t* inlier_ = nullptr;
  arena<Exec::space> memory_;
  arena<staging_space<Exec>> host_memory_;
};

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft

// SPDX-License-Identifier: Apache-2.0
/// @file Time per stage of calls that mark the ends of their stages: wall clock on the host, events
/// on a stream or in a graph on a device.
#pragma once

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "bench/clock.hpp"
#include "ft/core/execution.hpp"

namespace bench {
inline namespace FT_ABI {

template <typename Exec>
class stage_clock;

template <>
class stage_clock<ft::host_exec> {
public:
  explicit stage_clock(ft::host_exec const& exec) : exec_(exec) {}
  /// Runs `queue(exec, mark)` once; microseconds between marks.
  template <typename Queue>
  std::vector<double> run(Queue const& queue, bool) {
    std::vector<double> us;
    names_.clear();
    double last = now_us();
    queue(exec_, [&](char const* stage) {
      double const now = now_us();
      names_.emplace_back(stage);
      us.push_back(now - last);
      last = now_us();
    });
    return us;
  }
  std::vector<std::string> const& names() const { return names_; }

private:
  ft::host_exec exec_;
  std::vector<std::string> names_;
};

#if defined(__CUDACC__)
template <>
class stage_clock<ft::cuda_exec> {
public:
  explicit stage_clock(ft::cuda_exec const& exec) : exec_(exec) {
    for (std::size_t i = 0; i < most; ++i) { events_.emplace_back(cudaEventDefault); }
  }
  stage_clock(stage_clock const&) = delete;
  stage_clock& operator=(stage_clock const&) = delete;
  ~stage_clock() {
    if (graph_ != nullptr) { static_cast<void>(cudaGraphExecDestroy(graph_)); }
  }

  /// Runs `queue(exec, mark)` once; microseconds between events at the marks. Waits.
  /// @param recorded capture it first (once) and launch the graph, whose nodes the events are
  template <typename Queue>
  std::vector<double> run(Queue const& queue, bool recorded) {
    if (recorded && graph_ == nullptr) { record(queue); }
    if (recorded) {
      ft::throw_on_error(cudaGraphLaunch(graph_, exec_.stream), "cudaGraphLaunch");
    } else {
      queue_with_events(queue, exec_.stream, cudaEventRecordDefault);
    }
    exec_.wait();
    std::vector<double> us(names_.size());
    for (std::size_t i = 0; i < us.size(); ++i) {
      float ms = 0;
      ft::throw_on_error(cudaEventElapsedTime(&ms, events_[i].get(), events_[i + 1].get()),
                         "cudaEventElapsedTime");
      us[i] = 1000.0 * static_cast<double>(ms);
    }
    return us;
  }
  std::vector<std::string> const& names() const { return names_; }

private:
  static constexpr std::size_t most = 32;

  template <typename Queue>
  void queue_with_events(Queue const& queue, cudaStream_t stream, unsigned flags) {
    names_.clear();
    auto const event = [&](std::size_t i) {
      ft::throw_on_error(cudaEventRecordWithFlags(events_[i].get(), stream, flags),
                         "cudaEventRecordWithFlags");
    };
    event(0);
    queue(ft::cuda_exec(stream), [&](char const* stage) {
      if (names_.size() + 1 == most) { throw std::runtime_error("too many stages"); }
      names_.emplace_back(stage);
      event(names_.size());
    });
  }
  template <typename Queue>
  void record(Queue const& queue) {
    ft::stream const capturing;
    cudaGraph_t graph = nullptr;
    ft::throw_on_error(cudaStreamBeginCapture(capturing.get(), cudaStreamCaptureModeThreadLocal),
                       "cudaStreamBeginCapture");
    queue_with_events(queue, capturing.get(), cudaEventRecordExternal);
    ft::throw_on_error(cudaStreamEndCapture(capturing.get(), &graph), "cudaStreamEndCapture");
    ft::throw_on_error(cudaGraphInstantiateWithFlags(&graph_, graph, 0), "cudaGraphInstantiate");
    static_cast<void>(cudaGraphDestroy(graph));
  }

  ft::cuda_exec exec_;
  std::vector<ft::event> events_;
  cudaGraphExec_t graph_ = nullptr;
  std::vector<std::string> names_;
};
#endif

}  // namespace FT_ABI
}  // namespace bench

// SPDX-License-Identifier: Apache-2.0
/// @file Time of each stage of enqueued work: the wall clock on the host, events on a device.
///
/// In a recording the events are nodes of the graph. They depend on the launches whose end they
/// record, and no launch depends on them: with and without timing, the same launches run in the
/// same order.
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cstddef>
#include <cstring>
#include <vector>

#include "ft/core/config.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/types/tracking.hpp"

namespace ft {
inline namespace FT_ABI {

namespace detail {

/// The names and order of marks, shared by both clocks.
class stage_marks {
public:
  static constexpr int most = 40;

  void clear() { used_ = 0; }
  /// @param since of a stage on a branch: the mark of the fork @return the new mark
  /// @throws bad_argument for more than `most` marks
  int add(char const* name, int since = -1) {
    require(used_ < most, "a stage clock has no room for another stage");
    marks_[static_cast<std::size_t>(used_)] = {name, since};
    return used_++;
  }
  /// @param end_of end_of(i): time of mark i, microseconds after the first one
  template <typename EndOf>
  std::vector<stage_time> times(EndOf const& end_of) const {
    std::vector<stage_time> all;
    double latest = 0;  // latest end of the main line
    for (int i = 1; i < used_; ++i) {
      auto const& m = marks_[static_cast<std::size_t>(i)];
      double const end = end_of(i);
      bool const on_branch = m.since >= 0;
      double const us = on_branch ? end - end_of(m.since) : std::max(0.0, end - latest);
      if (!on_branch) { latest = std::max(latest, end); }
      add_to(all, m.name, us);
    }
    return all;
  }

private:
  struct mark {
    char const* name;
    int since;
  };
  static void add_to(std::vector<stage_time>& all, char const* name, double us) {
    for (auto& t : all) {
      if (std::strcmp(t.name, name) == 0) {
        t.us += us;
        return;
      }
    }
    all.push_back({name, us});
  }
  std::array<mark, most> marks_{};
  int used_ = 0;
};

}  // namespace detail

/// Marks the ends of stages. Without enable() every call returns at once. Not thread-safe.
template <typename Exec>
class stage_clock {
public:
  void enable() { enabled_ = true; }
  bool enabled() const { return enabled_; }
  /// Forgets all marks and sets the first one. @return the mark
  int begin(Exec const& exec) {
    marks_.clear();
    return mark(exec, "");
  }
  /// Marks the end of a stage, which began at the preceding mark. @param name a string literal
  /// @return the mark @throws bad_argument after stage_marks::most marks
  int mark(Exec const&, char const* name, int = -1) {
    if (!enabled_) { return -1; }
    int const i = marks_.add(name);
    at_[static_cast<std::size_t>(i)] = std::chrono::steady_clock::now();
    return i;
  }
  /// Stages in the order of their first marks. Allocates.
  std::vector<stage_time> times() const {
    return marks_.times([&](int i) {
      return std::chrono::duration<double, std::micro>(at_[static_cast<std::size_t>(i)] - at_[0])
          .count();
    });
  }

private:
  bool enabled_ = false;
  detail::stage_marks marks_;
  std::array<std::chrono::steady_clock::time_point, detail::stage_marks::most> at_{};
};

#if defined(__CUDACC__)

namespace detail {

/// Records an event on a stream. While the stream is captured: adds a node that records it to the
/// graph. The node depends on the last captured work, and nothing depends on the node.
inline void record_event(cudaEvent_t event, cudaStream_t stream) {
  cudaStreamCaptureStatus status = cudaStreamCaptureStatusNone;
  cudaGraph_t graph = nullptr;
  cudaGraphNode_t const* last = nullptr;
  std::size_t count = 0;
#if CUDART_VERSION >= 13000
  cudaGraphEdgeData const* edges = nullptr;
  throw_on_error(cudaStreamGetCaptureInfo(stream, &status, nullptr, &graph, &last, &edges, &count),
                 "cudaStreamGetCaptureInfo");
#elif CUDART_VERSION >= 12030
  cudaGraphEdgeData const* edges = nullptr;
  throw_on_error(
      cudaStreamGetCaptureInfo_v3(stream, &status, nullptr, &graph, &last, &edges, &count),
      "cudaStreamGetCaptureInfo_v3");
#else
  throw_on_error(cudaStreamGetCaptureInfo_v2(stream, &status, nullptr, &graph, &last, &count),
                 "cudaStreamGetCaptureInfo_v2");
#endif
  if (status == cudaStreamCaptureStatusActive) {
    cudaGraphNode_t node = nullptr;
    throw_on_error(cudaGraphAddEventRecordNode(&node, graph, last, count, event),
                   "cudaGraphAddEventRecordNode");
  } else {
    throw_on_error(cudaEventRecord(event, stream), "cudaEventRecord");
  }
}

}  // namespace detail

/// On a device: owns the events; move-only.
template <>
class stage_clock<cuda_exec> {
public:
  /// Creates the events; before the first mark. @throws cuda_error
  void enable() {
    events_.reserve(static_cast<std::size_t>(detail::stage_marks::most));
    for (int i = 0; i < detail::stage_marks::most; ++i) { events_.emplace_back(cudaEventDefault); }
  }
  bool enabled() const { return !events_.empty(); }
  int begin(cuda_exec const& exec) {
    marks_.clear();
    return mark(exec, "");
  }
  /// @param since of a stage on a branch: the mark of the fork
  int mark(cuda_exec const& exec, char const* name, int since = -1) {
    if (events_.empty()) { return -1; }
    int const i = marks_.add(name, since);
    detail::record_event(events_[static_cast<std::size_t>(i)].get(), exec.stream);
    return i;
  }
  /// After the executor's wait(). @throws cuda_error
  std::vector<stage_time> times() const {
    return marks_.times([&](int i) {
      float ms = 0;
      throw_on_error(
          cudaEventElapsedTime(&ms, events_[0].get(), events_[static_cast<std::size_t>(i)].get()),
          "cudaEventElapsedTime");
      return 1000.0 * static_cast<double>(ms);
    });
  }

private:
  detail::stage_marks marks_;
  std::vector<event> events_;
};

#endif

}  // namespace FT_ABI
}  // namespace ft

// SPDX-License-Identifier: Apache-2.0
/// @file An odometry with an executor of its own: host threads under a C++ compiler, a stream under
/// nvcc.
#pragma once

#include <memory>
#include <optional>
#include <utility>

#include "ft/any_odometry.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "ft/core/cuda_handles.hpp"
#include "ft/core/execution.hpp"
#include "ft/pipelines/erase.hpp"
#include "ft/pipelines/odometry.hpp"
#include "ft/types/features.hpp"
#include "ft/types/imu.hpp"
#include "library/factories.hpp"

namespace ft::library::FT_LIBRARY_DEVICE {

#if defined(__CUDACC__)
/// A GPU, made current during each call, and the stream there.
class place {
  /// Makes a GPU current, and the one before it at its end.
  class current {
  public:
    explicit current(int gpu) {
      throw_on_error(cudaGetDevice(&before_), "cudaGetDevice");
      changed_ = gpu != before_ && gpu != device::current_gpu;
      if (changed_) { throw_on_error(cudaSetDevice(gpu), "cudaSetDevice"); }
    }
    current(current const&) = delete;
    current& operator=(current const&) = delete;
    ~current() {
      if (changed_) { static_cast<void>(cudaSetDevice(before_)); }
    }

  private:
    int before_ = 0;
    bool changed_ = false;
  };

public:
  using exec_type = cuda_exec;
  explicit place(device const& where) : gpu_(where.gpu) {
    int gpus = 0;
    throw_on_error(cudaGetDeviceCount(&gpus), "cudaGetDeviceCount");
    if (gpu_ == device::current_gpu) { throw_on_error(cudaGetDevice(&gpu_), "cudaGetDevice"); }
    detail::require_range("gpu", gpu_, 0, gpus - 1);
    current const here(gpu_);
    stream_ = static_cast<cudaStream_t>(where.stream);
    if (stream_ == nullptr) { stream_ = own_.emplace().get(); }
  }
  current enter() const { return current(gpu_); }
  cuda_exec exec() const { return cuda_exec(stream_); }

private:
  int gpu_;
  std::optional<stream> own_;
  cudaStream_t stream_ = nullptr;
};
#else
class place : public detail::calling_thread {
public:
  using exec_type = host_exec;
  explicit place(device const& where) : exec_(where.threads) {}
  host_exec const& exec() const { return exec_; }

private:
  host_exec exec_;
};
#endif

/// By keypoints of the caller whose descriptors are not ORB's: what most rigs share, so that a unit
/// takes the compiler a minute.
/// @throws bad_argument also for an IMU or words
template <typename Rig>
any_odometry made_of_features(odometry_request const& of, Rig const& rig) {
  using exec_type = place::exec_type;
  using odometry_type = odometry<exec_type, Rig>;
  detail::require(!of.params.imu.present && of.places.vocabulary.empty(),
                  "ft::odometry has no IMU and no words with other descriptors than ORB's");
  place here(of.where);
  [[maybe_unused]] auto const entered = here.enter();
  auto const make = [&](place& p, vocabulary_view const&) {
    return of.params.loops.present
               ? odometry_type(p.exec(), rig, of.params, of.batch, loops{}, own_features{})
               : odometry_type(p.exec(), rig, of.params, of.batch, own_features{});
  };
  return any_odometry(std::make_unique<detail::erased_odometry<exec_type, Rig, place>>(
      std::move(here), vocabulary<exec_type::space>(), make));
}

template <typename Rig>
any_odometry made(odometry_request const& of, Rig const& rig) {
  using exec_type = place::exec_type;
  using odometry_type = odometry<exec_type, Rig>;
  place here(of.where);
  [[maybe_unused]] auto const entered = here.enter();
  bool const with_places = !of.places.vocabulary.empty();
  place_recovery how;
  how.candidates = of.places.candidates;
  check(how);
  vocabulary<exec_type::space> words;
  if (with_places) { words = upload(here.exec(), read_vocabulary(of.places.vocabulary).view()); }
  auto const make = [&](place& p, vocabulary_view const& kept) {
    auto const with = [&](auto const&... plugged) {
      return odometry_type(p.exec(), rig, of.params, of.batch, plugged..., own_features{});
    };
    auto const with_loops = [&](auto const&... plugged) {
      return of.params.loops.present ? with(plugged..., loops{}) : with(plugged...);
    };
    places const by_words{kept, how};
    if (of.params.imu.present) {
      return with_places ? with_loops(inertial{}, by_words) : with_loops(inertial{});
    }
    return with_places ? with_loops(by_words) : with_loops();
  };
  return any_odometry(std::make_unique<detail::erased_odometry<exec_type, Rig, place>>(
      std::move(here), std::move(words), make));
}

}  // namespace ft::library::FT_LIBRARY_DEVICE

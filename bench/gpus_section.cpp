// SPDX-License-Identifier: Apache-2.0
// The section of several devices: a batch on each, from one process, a thread a device.
#include <algorithm>
#include <atomic>
#include <cstdio>
#include <exception>
#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <thread>
#include <vector>

#include "bench/clock.hpp"
#include "bench/plan.hpp"
#include "bench/sections.hpp"

namespace bench {

namespace {

/// Runs frame i of a batch to its end.
using batch_type = std::function<void(int i)>;

/// Lets threads begin at the same time, once all are ready.
class start_line {
public:
  explicit start_line(int threads) : missing_(threads) {}
  /// A thread that failed does not keep the others waiting.
  void ready() { --missing_; }
  void wait() const {
    while (missing_ > 0) { std::this_thread::yield(); }
  }

private:
  std::atomic<int> missing_;
};

/// Each device runs its own batch in a thread of its own.
/// @param make called in each thread, with its device selected
/// @return time in which all devices ran `calls` frames after `warm_up` ones, microseconds
/// @throws what a thread threw
double time_devices(int devices, std::function<batch_type()> const& make, int warm_up, int calls) {
  start_line line(devices);
  std::mutex lock;
  std::exception_ptr failure;
  double begin = 0;
  double end = 0;
  auto const run = [&](int device) {
    bool waits = true;
    try {
      use_cuda_device(device);
      batch_type const frame = make();
      for (int i = 0; i < warm_up; ++i) { frame(i); }
      waits = false;
      line.ready();
      line.wait();
      double const start = now_us();
      for (int i = warm_up; i < warm_up + calls; ++i) { frame(i); }
      double const stop = now_us();
      std::lock_guard<std::mutex> const hold(lock);
      begin = begin > 0 ? std::min(begin, start) : start;
      end = std::max(end, stop);
    } catch (...) {
      if (waits) { line.ready(); }
      std::lock_guard<std::mutex> const hold(lock);
      if (!failure) { failure = std::current_exception(); }
    }
  };
  std::vector<std::thread> threads;
  for (int device = 0; device < devices; ++device) { threads.emplace_back(run, device); }
  for (auto& t : threads) { t.join(); }
  if (failure) { std::rethrow_exception(failure); }
  return end - begin;
}

batch_type tracker_batch(scene const& s, frame_options const& how) {
  std::shared_ptr<frame_runner> const runner = make_frame_runner(s, how);
  return [runner](int i) {
    runner->prepare(i);
    runner->launch(call_type::whole);
    runner->wait();
  };
}

batch_type odometry_batch(scene const& s, frame_options const& how) {
  std::shared_ptr<odometry_runner> const runner = make_odometry_runner(s, how);
  return [runner](int i) {
    runner->prepare(i);
    runner->track();
  };
}

}  // namespace

void gpus_section(context const& c) {
  int const found = cuda_devices();
  int const most = c.how.gpus > 0 ? std::min(c.how.gpus, found) : found;
  scene const& s = c.all_scenes->get(rig_type::rectified);
  std::printf(
      "\nBatches on several devices, one thread a device, one process\n%-12s %6s %6s %6s "
      "%12s %12s\n",
      "what", "GPUs", "batch", "calls", "frames/s", "times one");
  frame_options o;
  o.backend = backend_type::cuda;
  o.batch = c.how.batches.empty() ? 64 : c.how.batches.front();
  int const calls = calls_of_batch(c.how.frames_on(o.backend), o.batch);
  int const warm_up =
      std::max(c.how.warm_up_on(o.backend) / 4, 2 * static_cast<int>(s.frames.size()));
  auto const time = [&](char const* name, std::function<batch_type()> const& make) {
    double one = 0;
    for (int devices = 1; devices <= most; devices *= 2) {
      double const us = time_devices(devices, make, warm_up, calls);
      double const rate = 1e6 * calls * o.batch * devices / us;
      if (devices == 1) { one = rate; }
      std::printf("%-12s %6d %6d %6d %12.0f %12.3f\n", name, devices, o.batch, calls, rate,
                  rate / one);
      std::fflush(stdout);
      (*c.out)["gpus"].push_back({{"name", name},
                                  {"gpus", devices},
                                  {"batch", o.batch},
                                  {"calls", calls},
                                  {"frames_per_s", rate},
                                  {"times_one", rate / one}});
    }
  };
  time("tracker", [&] { return tracker_batch(s, o); });
  time("odometry", [&] { return odometry_batch(s, o); });
}

}  // namespace bench

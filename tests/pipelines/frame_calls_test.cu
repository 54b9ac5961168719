// SPDX-License-Identifier: Apache-2.0
// What a frame asks of the CUDA runtime and of the heap. The linker puts the functions below in the
// place of the runtime's (--wrap, see tests/CMakeLists.txt), so everything that ft calls is
// counted: one graph launch a call of the tracker, one wait, which is the caller's, and nothing
// else.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <new>
#include <ostream>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace frame_calls_test {

struct call_counts {
  int graph_launches = 0;
  int waits = 0;        ///< the host stands until the device has done something
  int polls = 0;        ///< it asks whether the device has
  int allocations = 0;  ///< memory of any kind, streams, events, graphs: taken or given back
  int queued = 0;       ///< kernels, copies, events, one by one

  friend bool operator==(call_counts const& a, call_counts const& b) {
    return a.graph_launches == b.graph_launches && a.waits == b.waits && a.polls == b.polls &&
           a.allocations == b.allocations && a.queued == b.queued;
  }
  friend std::ostream& operator<<(std::ostream& out, call_counts const& c) {
    return out << c.graph_launches << " graph launches, " << c.waits << " waits, " << c.polls
               << " polls, " << c.allocations << " allocations, " << c.queued
               << " launches and copies";
  }
};

call_counts& calls() {
  thread_local call_counts counts;
  return counts;
}

/// What `work` calls, on this thread.
template <typename Work>
call_counts calls_during(Work const& work) {
  calls() = {};
  work();
  return calls();
}

}  // namespace frame_calls_test

// ---- in place of the runtime's functions --------------------------------------------------------

#define FT_COUNTED(kind, result, name, parameters, arguments) \
  extern "C" result __real_##name parameters;                 \
  extern "C" result __wrap_##name parameters {                \
    ++frame_calls_test::calls().kind;                         \
    return __real_##name arguments;                           \
  }
#define FT_COUNTED_CALL(kind, name, parameters, arguments) \
  FT_COUNTED(kind, cudaError_t, name, parameters, arguments)

FT_COUNTED_CALL(graph_launches, cudaGraphLaunch, (cudaGraphExec_t g, cudaStream_t s), (g, s))

FT_COUNTED_CALL(waits, cudaStreamSynchronize, (cudaStream_t s), (s))
FT_COUNTED_CALL(waits, cudaDeviceSynchronize, (), ())
FT_COUNTED_CALL(waits, cudaEventSynchronize, (cudaEvent_t e), (e))
FT_COUNTED_CALL(waits, cudaMemcpy, (void* to, void const* from, std::size_t n, cudaMemcpyKind k),
                (to, from, n, k))
FT_COUNTED_CALL(waits, cudaMemcpy2D,
                (void* to, std::size_t tp, void const* from, std::size_t fp, std::size_t w,
                 std::size_t h, cudaMemcpyKind k),
                (to, tp, from, fp, w, h, k))
FT_COUNTED_CALL(waits, cudaMemset, (void* to, int value, std::size_t n), (to, value, n))

FT_COUNTED_CALL(polls, cudaStreamQuery, (cudaStream_t s), (s))
FT_COUNTED_CALL(polls, cudaEventQuery, (cudaEvent_t e), (e))

FT_COUNTED_CALL(allocations, cudaMalloc, (void** p, std::size_t n), (p, n))
FT_COUNTED_CALL(allocations, cudaMallocHost, (void** p, std::size_t n), (p, n))
FT_COUNTED_CALL(allocations, cudaHostAlloc, (void** p, std::size_t n, unsigned f), (p, n, f))
FT_COUNTED_CALL(allocations, cudaHostRegister, (void* p, std::size_t n, unsigned f), (p, n, f))
FT_COUNTED_CALL(allocations, cudaMallocManaged, (void** p, std::size_t n, unsigned f), (p, n, f))
FT_COUNTED_CALL(allocations, cudaMallocAsync, (void** p, std::size_t n, cudaStream_t s), (p, n, s))
FT_COUNTED_CALL(allocations, cudaFree, (void* p), (p))
FT_COUNTED_CALL(allocations, cudaFreeHost, (void* p), (p))
FT_COUNTED_CALL(allocations, cudaFreeAsync, (void* p, cudaStream_t s), (p, s))
FT_COUNTED_CALL(allocations, cudaStreamCreate, (cudaStream_t * s), (s))
FT_COUNTED_CALL(allocations, cudaStreamCreateWithFlags, (cudaStream_t * s, unsigned f), (s, f))
FT_COUNTED_CALL(allocations, cudaEventCreateWithFlags, (cudaEvent_t * e, unsigned f), (e, f))
FT_COUNTED_CALL(allocations, cudaGraphInstantiateWithFlags,
                (cudaGraphExec_t * e, cudaGraph_t g, unsigned long long f), (e, g, f))

FT_COUNTED_CALL(queued, cudaMemcpyAsync,
                (void* to, void const* from, std::size_t n, cudaMemcpyKind k, cudaStream_t s),
                (to, from, n, k, s))
FT_COUNTED_CALL(queued, cudaMemcpy2DAsync,
                (void* to, std::size_t tp, void const* from, std::size_t fp, std::size_t w,
                 std::size_t h, cudaMemcpyKind k, cudaStream_t s),
                (to, tp, from, fp, w, h, k, s))
FT_COUNTED_CALL(queued, cudaMemsetAsync, (void* to, int value, std::size_t n, cudaStream_t s),
                (to, value, n, s))
FT_COUNTED_CALL(queued, cudaEventRecord, (cudaEvent_t e, cudaStream_t s), (e, s))
FT_COUNTED_CALL(queued, cudaStreamWaitEvent, (cudaStream_t s, cudaEvent_t e, unsigned f), (s, e, f))
FT_COUNTED_CALL(queued, cudaLaunchKernel,
                (void const* f, dim3 grid, dim3 block, void** a, std::size_t shared,
                 cudaStream_t s),
                (f, grid, block, a, shared, s))
#if CUDART_VERSION >= 13000  // what <<< >>> calls from there on
FT_COUNTED_CALL(queued, cudaLaunchKernelExC,
                (cudaLaunchConfig_t const* config, void const* kernel, void** arguments),
                (config, kernel, arguments))
FT_COUNTED_CALL(queued, __cudaLaunchKernel,
                (cudaKernel_t f, dim3 grid, dim3 block, void** a, std::size_t shared,
                 cudaStream_t s),
                (f, grid, block, a, shared, s))
#endif

// operator new by its names in object files: nvcc has it on the device, too, so that it cannot be
// replaced in the language.
FT_COUNTED(allocations, void*, _Znwm, (std::size_t n), (n))
FT_COUNTED(allocations, void*, _Znam, (std::size_t n), (n))
FT_COUNTED(allocations, void*, _ZnwmSt11align_val_t, (std::size_t n, std::align_val_t a), (n, a))
FT_COUNTED(allocations, void*, _ZnamSt11align_val_t, (std::size_t n, std::align_val_t a), (n, a))

namespace frame_calls_test {

// ---- the counting itself: no device is needed, a call that fails counts as well
// ------------------

TEST(counted_calls, nothing_is_counted_where_nothing_is_called) {
  EXPECT_EQ(calls_during([] {}), call_counts{});
}

TEST(counted_calls, a_wait_in_a_frame_would_be_seen) {
  auto const waits = [](auto const& call) {
    int const n = calls_during([&] { static_cast<void>(call()); }).waits;
    cudaGetLastError();
    return n;
  };
  EXPECT_EQ(waits([] { return cudaStreamSynchronize(nullptr); }), 1);
  EXPECT_EQ(waits([] { return cudaDeviceSynchronize(); }), 1);
  EXPECT_EQ(waits([] { return cudaEventSynchronize(nullptr); }), 1);
  int a = 0;
  int b = 0;
  EXPECT_EQ(waits([&] { return cudaMemcpy(&a, &b, sizeof a, cudaMemcpyHostToHost); }), 1);
  // and one in ft's own code, behind its executor
  EXPECT_EQ(waits([] {
              try {
                ft::cuda_exec(nullptr).wait();
              } catch (ft::cuda_error const&) {}
              return cudaSuccess;
            }),
            1);
}

TEST(counted_calls, an_allocation_in_a_frame_would_be_seen) {
  auto const allocations = [](auto const& call) {
    int const n = calls_during(call).allocations;
    cudaGetLastError();
    return n;
  };
  EXPECT_GE(allocations([] {
              std::vector<int> const v(1000, 1);
              ASSERT_EQ(v[999], 1);
            }),
            1);
  EXPECT_GE(allocations([] { ft::buffer<int, ft::memory_space::host> const b(1000); }), 1);
  EXPECT_GE(allocations([] {
              void* p = nullptr;
              if (cudaMalloc(&p, 16) == cudaSuccess) { cudaFree(p); }
            }),
            1);
  EXPECT_GE(allocations([] {
              void* p = nullptr;
              if (cudaMallocHost(&p, 16) == cudaSuccess) { cudaFreeHost(p); }
            }),
            1);
}

TEST(counted_calls, a_launch_and_a_copy_beside_the_graph_would_be_seen) {
  int a = 0;
  int b = 0;
  EXPECT_EQ(calls_during([&] {
              static_cast<void>(cudaMemcpyAsync(&a, &b, sizeof a, cudaMemcpyHostToHost, nullptr));
            }).queued,
            1);
  cudaGetLastError();
}

// ---- a frame ------------------------------------------------------------------------------------

class frame_calls : public test::on_backend<test::cuda_backend> {
protected:
  test::cuda_backend backend;
};

constexpr int width = 320;
constexpr int height = 240;

ft::tracker_params params() {
  ft::tracker_params p;
  p.orb.width = width;
  p.orb.height = height;
  p.orb.features = 400;
  p.map_slots = 500;
  p.local_points = 300;
  p.updates = 300;
  return p;
}

/// A tracker whose map is what it saw with depth in its first frame.
template <typename Rig>
class tracked_scene {
public:
  using tracker_type = ft::frame_tracker<ft::cuda_exec, Rig>;
  tracked_scene(ft::cuda_exec const& exec, Rig const& rig, ft::tracker_params const& p = params())
      : tracker(exec, rig, p), exec_(exec) {
    next_frame();
    tracker.extract(exec_);
    exec_.wait();
    auto const& r = tracker.result();
    std::vector<ft::descriptor> orb(static_cast<std::size_t>(tracker.capacity()));
    tracker.download_descriptors(exec_, 0, orb.data(), r.keypoints[0]);
    exec_.wait();
    for (int i = 0; i < r.keypoints[0] && points < params().local_points; ++i) {
      if (!(r.depth[i] > 0)) { continue; }
      ft::point_update u{};
      u.slot = points;
      u.observations = 3;
      u.position = r.point[i];
      u.normal = {0, 0, 1};
      u.max_distance = 2 * r.depth[i];
      u.min_distance = r.depth[i] / 4;
      u.orb = orb[static_cast<std::size_t>(i)];
      updates.push_back(u);
      slots.push_back(points);
      ++points;
    }
    tracker.update_map(exec_, 0, updates.data(), points);
    exec_.wait();
  }

  /// Input of a frame: the same pair, shifted against each other.
  void next_frame() {
    auto const image = test::random_image(width + disparity, height, 7);
    tracker.set_image(0, 0, {image.data(), width, height, width + disparity});
    tracker.set_image(0, 1, {image.data() + disparity, width, height, width + disparity});
    std::vector<int> holders(static_cast<std::size_t>(tracker_type::cameras * tracker.capacity()),
                             -1);
    std::copy(slots.begin(), slots.end(), holders.begin());
    tracker.set_last(exec_, 0, ft::pose::identity(), holders);
    exec_.wait();
  }
  ft::frame_input input() const { return {ft::pose::identity(), slots}; }

  tracker_type tracker;
  std::vector<ft::point_update> updates;
  std::vector<int> slots;  ///< of all points
  int points = 0;

private:
  static constexpr int disparity = 12;
  ft::cuda_exec const& exec_;
};

call_counts one_graph_launch() {
  call_counts c;
  c.graph_launches = 1;
  return c;
}
call_counts one_wait() {
  call_counts c;
  c.waits = 1;
  return c;
}

template <typename Rig>
void expect_graphs_alone(ft::cuda_exec const& exec, Rig const& rig) {
  tracked_scene<Rig> scene(exec, rig);
  auto& tracker = scene.tracker;
  for (int i = 0; i < 4; ++i) {
    scene.next_frame();
    EXPECT_EQ(calls_during([&] { tracker.track(exec, scene.input()); }), one_graph_launch())
        << "frame " << i;
    EXPECT_EQ(calls_during([&] { exec.wait(); }), one_wait());
    EXPECT_GT(tracker.result().keypoints[0], 100) << "there was a frame";

    // The host chooses the local map in between: two launches, each with a wait of the caller's.
    scene.next_frame();
    EXPECT_EQ(calls_during([&] { tracker.track_motion(exec, ft::pose::identity()); }),
              one_graph_launch());
    EXPECT_EQ(calls_during([&] { exec.wait(); }), one_wait());
    EXPECT_EQ(calls_during([&] { tracker.track_local(exec, scene.slots); }), one_graph_launch());
    EXPECT_EQ(calls_during([&] { exec.wait(); }), one_wait());

    scene.next_frame();
    EXPECT_EQ(calls_during([&] { tracker.extract(exec); }), one_graph_launch());
    EXPECT_EQ(calls_during([&] { exec.wait(); }), one_wait());
  }
}

TEST_F(frame_calls, of_a_rectified_pair_are_one_graph_launch_and_the_callers_wait) {
  expect_graphs_alone(backend.exec,
                      ft::rectified_rig::make({200.0f, 200.0f, 159.5f, 119.5f}, 0.2f));
}

TEST_F(frame_calls, of_a_fisheye_pair_are_one_graph_launch_and_the_callers_wait) {
  ft::kannala_brandt<float> const camera{140.0f,  140.0f, 159.5f,  119.5f,
                                         -0.012f, 0.003f, -0.002f, 0.0003f};
  ft::pose T_rl = ft::pose::identity();
  T_rl.t.x = -0.2f;
  using rig = ft::stereo_rig<ft::kannala_brandt<float>, ft::kannala_brandt<float>>;
  expect_graphs_alone(backend.exec, rig{camera, camera, T_rl});
}

TEST_F(frame_calls, queued_one_by_one_a_frame_still_neither_waits_nor_allocates) {
  auto p = params();
  p.use_graphs = false;
  tracked_scene<ft::rectified_rig> scene(
      backend.exec, ft::rectified_rig::make({200.0f, 200.0f, 159.5f, 119.5f}, 0.2f), p);
  scene.next_frame();
  call_counts const c = calls_during([&] { scene.tracker.track(backend.exec, scene.input()); });
  EXPECT_GT(c.queued, 15);
  EXPECT_EQ(c.graph_launches, 0);
  EXPECT_EQ(c.waits + c.polls + c.allocations, 0) << c;
  backend.exec.wait();
}

TEST_F(frame_calls, of_a_map_update_are_a_copy_and_a_kernel) {
  tracked_scene<ft::rectified_rig> scene(
      backend.exec, ft::rectified_rig::make({200.0f, 200.0f, 159.5f, 119.5f}, 0.2f));
  ASSERT_GT(scene.points, 0);
  call_counts const c = calls_during(
      [&] { scene.tracker.update_map(backend.exec, 0, scene.updates.data(), scene.points); });
  EXPECT_EQ(c.queued, 2);
  EXPECT_EQ(c.graph_launches + c.waits + c.polls + c.allocations, 0) << c;
  backend.exec.wait();
}

}  // namespace frame_calls_test

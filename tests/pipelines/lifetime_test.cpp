// SPDX-License-Identifier: Apache-2.0
// Moves, destruction in any order, memory that runs out and errors of kernels from elsewhere: each
// is answered as documented, and a tracker beside it goes on with the same bits.
#include <gtest/gtest.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <new>
#include <utility>
#include <vector>

#include "ft/containers/feature_grid.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/random.hpp"
#include "tests/support/tracking.hpp"

namespace lifetime_test {

constexpr int width = 160;
constexpr int height = 120;

ft::tracker_params params() {
  ft::tracker_params p;
  p.orb.width = width;
  p.orb.height = height;
  p.orb.levels = 4;
  p.orb.features = 200;
  p.map_slots = 64;
  p.local_points = 32;
  p.updates = 32;
  return p;
}
ft::rectified_rig rig() { return ft::rectified_rig::make({100, 100, 80, 60}, 0.1f); }

template <typename Exec>
void give_images(ft::frame_tracker<Exec>& tracker) {
  for (int c = 0; c < 2; ++c) {
    auto const pixels = test::random_image(width, height, 3);
    tracker.set_image(0, c, {pixels.data(), width, height, width});
  }
}

/// The same frame for every tracker.
template <typename Exec>
test::snapshot extract(Exec const& exec, ft::frame_tracker<Exec>& tracker) {
  give_images(tracker);
  tracker.extract(exec);
  exec.wait();
  return test::take(tracker, 0, 0);
}

template <typename Backend>
class lifetime : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using extractor = ft::orb_extractor<exec_type>;
  using matcher = ft::stereo_matcher<exec_type>;
  using tracker_type = ft::frame_tracker<exec_type>;
  Backend backend;
  exec_type const& exec() const { return backend.exec; }

  /// Every call that works on what an extractor owns.
  void expect_refuses(extractor& orb) const {
    std::vector<std::uint8_t> const pixels(width * height);
    ft::gray_view const view{pixels.data(), width, height, width};
    EXPECT_THROW(orb.upload(exec(), 0, view), ft::bad_argument);
    EXPECT_THROW(orb.set_mask(exec(), 0, view), ft::bad_argument);
    EXPECT_THROW(orb.extract(exec()), ft::bad_argument);
    EXPECT_THROW(orb.build_levels(exec()), ft::bad_argument);
    EXPECT_THROW(orb.build_pyramids(exec()), ft::bad_argument);
    EXPECT_THROW(orb.describe_keypoints(exec(), ft::described_view{}), ft::bad_argument);
    EXPECT_THROW(matcher(rig(), orb), ft::bad_argument);
    EXPECT_EQ(orb.batch(), 0);
    EXPECT_EQ(orb.bytes(), 0u);
  }
  void expect_refuses(tracker_type& t) const {
    std::vector<std::uint8_t> const pixels(width * height);
    ft::gray_view const view{pixels.data(), width, height, width};
    ft::point_update const point{};
    ft::descriptor orb;
    EXPECT_THROW(t.set_image(0, 0, view), ft::bad_argument);
    EXPECT_THROW(t.borrow_image(0, 0, view), ft::bad_argument);
    EXPECT_THROW(t.staged_image(0, 0), ft::bad_argument);
    EXPECT_THROW(t.set_mask(exec(), 0, 0, view), ft::bad_argument);
    EXPECT_THROW(t.update_map(exec(), 0, &point, 1), ft::bad_argument);
    EXPECT_THROW(t.extract(exec()), ft::bad_argument);
    ft::frame_input const input{};
    EXPECT_THROW(t.set_last(exec(), 0, ft::pose::identity(), {}), ft::bad_argument);
    EXPECT_THROW(t.track_motion(exec(), ft::pose::identity()), ft::bad_argument);
    EXPECT_THROW(t.track_motion(exec(), &input.T_predicted), ft::bad_argument);
    EXPECT_THROW(t.track(exec(), input), ft::bad_argument);
    EXPECT_THROW(t.track(exec(), &input), ft::bad_argument);
    EXPECT_THROW(t.track_local(exec(), ft::slot_list{}), ft::bad_argument);
    EXPECT_THROW(t.track_local(exec(), &input.local_slots), ft::bad_argument);
    EXPECT_THROW(t.relocalize(exec(), input), ft::bad_argument);
    EXPECT_THROW(t.relocalize(exec(), &input), ft::bad_argument);
    EXPECT_THROW(t.frame(), ft::bad_argument);
    EXPECT_THROW(t.stage_times(), ft::bad_argument);
    EXPECT_THROW(t.download_descriptors(exec(), 0, &orb, 1), ft::bad_argument);
    EXPECT_EQ(t.batch(), 0);
  }
};
TYPED_TEST_SUITE(lifetime, test::backends);

// NOLINTBEGIN(bugprone-use-after-move): what happens then is what is tested

TYPED_TEST(lifetime, what_was_never_made_or_was_moved_from_refuses_every_call) {
  auto const& exec = this->exec();
  typename TestFixture::extractor unmade;
  this->expect_refuses(unmade);
  typename TestFixture::extractor first(exec, params().orb, 2);
  typename TestFixture::extractor second(std::move(first));
  this->expect_refuses(first);
  first = std::move(second);
  this->expect_refuses(second);

  typename TestFixture::matcher none;
  EXPECT_THROW(none.match(exec, first), ft::bad_argument);
  typename TestFixture::matcher stereo(rig(), first);
  typename TestFixture::matcher taken(std::move(stereo));
  EXPECT_THROW(stereo.match(exec, first), ft::bad_argument);
  EXPECT_THROW(stereo.match_sorted(exec, first), ft::bad_argument);
  EXPECT_THROW(stereo.match(exec, second), ft::bad_argument) << "both are empty";

  typename TestFixture::tracker_type no_tracker;
  this->expect_refuses(no_tracker);
  typename TestFixture::tracker_type a(exec, rig(), params());
  auto const want = extract(exec, a);
  ASSERT_GT(want.keypoints[0], 20);
  typename TestFixture::tracker_type b(std::move(a));
  this->expect_refuses(a);
  test::expect_same(extract(exec, b), want);
  a = std::move(b);
  this->expect_refuses(b);
  test::expect_same(extract(exec, a), want);
}

TYPED_TEST(lifetime, containers_that_were_moved_from_have_no_view) {
  constexpr auto space = TypeParam::exec_type::space;
  ft::image_pyramid<space> pyramid(ft::pyramid_geometry::make(64, 48, 2, 1.2f), 2);
  auto* const pixels = pyramid.view().data;
  ft::image_pyramid<space> pyramid_taken(std::move(pyramid));
  EXPECT_EQ(pyramid.view().data, nullptr);
  EXPECT_EQ(pyramid.view().batch, 0);
  EXPECT_EQ(pyramid_taken.view().data, pixels);
  pyramid = std::move(pyramid_taken);
  EXPECT_EQ(pyramid_taken.view().data, nullptr);
  EXPECT_EQ(pyramid.view().data, pixels);

  ft::feature_grid<space> grid(ft::grid_geometry::over(0, 0, 64, 48), 10, 2);
  auto* const start = grid.view().start;
  ft::feature_grid<space> grid_taken(std::move(grid));
  EXPECT_EQ(grid.view().start, nullptr);
  EXPECT_EQ(grid.view().capacity, 0);
  grid = std::move(grid_taken);
  EXPECT_EQ(grid_taken.view().indices, nullptr);
  EXPECT_EQ(grid.view().start, start);
}
// NOLINTEND(bugprone-use-after-move)

TYPED_TEST(lifetime, owners_may_go_in_any_order) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type witness(exec, rig(), params());
  auto const want = extract(exec, witness);
  std::array<int, 4> order{0, 1, 2, 3};
  do {
    auto own_exec = std::make_unique<typename TestFixture::exec_type>(exec);
    auto orb = std::make_unique<typename TestFixture::extractor>(*own_exec, params().orb, 2);
    auto stereo = std::make_unique<typename TestFixture::matcher>(rig(), *orb);
    auto tracker = std::make_unique<typename TestFixture::tracker_type>(*own_exec, rig(), params());
    orb->extract(*own_exec);
    stereo->match(*own_exec, *orb);
    test::expect_same(extract(*own_exec, *tracker), want);
    for (int const which : order) {
      if (which == 0) { own_exec.reset(); }
      if (which == 1) { orb.reset(); }
      if (which == 2) { stereo.reset(); }
      if (which == 3) { tracker.reset(); }
    }
  } while (std::next_permutation(order.begin(), order.end()));
  test::expect_same(extract(exec, witness), want);
}

// ---- memory -----------------------------------------------------------------------------------

#if !FT_TEST_ASAN  // which ends the program instead of throwing
/// Lets the process have that much more memory and no more, also where the system promises memory
/// that it has not.
class memory_limit {
public:
  explicit memory_limit(std::size_t more) {
    unsigned long pages = 0;
    std::ifstream("/proc/self/statm") >> pages;
    getrlimit(RLIMIT_AS, &before_);
    rlimit limit = before_;
    limit.rlim_cur = pages * static_cast<unsigned long>(sysconf(_SC_PAGESIZE)) + more;
    EXPECT_EQ(setrlimit(RLIMIT_AS, &limit), 0);
  }
  memory_limit(memory_limit const&) = delete;
  memory_limit& operator=(memory_limit const&) = delete;
  ~memory_limit() { EXPECT_EQ(setrlimit(RLIMIT_AS, &before_), 0); }

private:
  rlimit before_{};
};

TYPED_TEST(lifetime, memory_that_is_not_there_throws_and_harms_nobody) {
  auto const& exec = this->exec();
  typename TestFixture::tracker_type witness(exec, rig(), params());
  auto const want = extract(exec, witness);
  auto huge = params();
  huge.map_slots = 1 << 26;  // 2048 maps of them: about 14 terabytes
  huge.orb.width = huge.orb.height = 8;
  huge.orb.levels = 1;
  for (int i = 0; i < 3; ++i) {
    auto const make = [&] { typename TestFixture::tracker_type const t(exec, rig(), huge, 2048); };
    if constexpr (TypeParam::exec_type::space == ft::memory_space::host) {
      memory_limit const limit(std::size_t{1} << 34);
      EXPECT_THROW(make(), std::bad_alloc);
    } else {
      EXPECT_THROW(make(), ft::cuda_error);
    }
    test::expect_same(extract(exec, witness), want);
  }
  typename TestFixture::tracker_type another(exec, rig(), params());
  test::expect_same(extract(exec, another), want);
}
#endif

#if defined(__CUDACC__)

/// All of the device's memory but `rest` bytes, in pieces.
class hog {
public:
  explicit hog(std::size_t rest) {
    std::size_t free = 0;
    std::size_t total = 0;
    ft::throw_on_error(cudaMemGetInfo(&free, &total), "cudaMemGetInfo");
    for (std::size_t piece = std::size_t{1} << 33; piece >= (1 << 20); piece /= 2) {
      for (void* p = nullptr; free > rest + piece && cudaMalloc(&p, piece) == cudaSuccess;) {
        pieces_.push_back(p);
        ft::throw_on_error(cudaMemGetInfo(&free, &total), "cudaMemGetInfo");
      }
    }
    cudaGetLastError();
  }
  hog(hog const&) = delete;
  hog& operator=(hog const&) = delete;
  ~hog() {
    for (void* p : pieces_) { static_cast<void>(cudaFree(p)); }
  }

private:
  std::vector<void*> pieces_;
};

TEST(device_lifetime, a_full_device_refuses_a_tracker_and_takes_it_once_there_is_room) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  using tracker = ft::frame_tracker<ft::cuda_exec>;
  tracker witness(backend.exec, rig(), params());
  auto const want = extract(backend.exec, witness);
  auto large = params();
  large.map_slots = 1 << 22;  // about 400 MB
  {
    hog const full(std::size_t{64} << 20);
    EXPECT_THROW(tracker(backend.exec, rig(), large), ft::cuda_error);
    test::expect_same(extract(backend.exec, witness), want);
  }
  tracker later(backend.exec, rig(), large);
  test::expect_same(extract(backend.exec, later), want);
}

template <typename T>
__global__ void users_kernel(T* where) {
  *where = T{1};
}

TEST(device_lifetime, a_launch_of_the_user_that_failed_harms_nothing_after_it) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  ft::orb_extractor<ft::cuda_exec> orb(backend.exec, params().orb, 2);
  int* nowhere = nullptr;
  users_kernel<<<1, 4096>>>(nowhere);  // no block has so many threads: never runs
#if CUDART_VERSION >= 12030
  EXPECT_NO_THROW(orb.extract(backend.exec));
  EXPECT_NO_THROW(backend.exec.wait());
#else  // a launch's own error cannot be told from one before
  EXPECT_THROW(orb.extract(backend.exec), ft::cuda_error);
#endif
  EXPECT_NO_THROW(orb.extract(backend.exec));
  EXPECT_NO_THROW(backend.exec.wait());
}

/// In a process of its own: the device's context is lost with such an error.
void fault_and_go_on() {
  test::cuda_backend backend;
  int thrown = 0;
  auto const expect_cuda_error = [&](auto const& call) {
    try {
      call();
    } catch (ft::cuda_error const& e) {
      std::fprintf(stderr, "%s\n", e.what());
      ++thrown;
    }
  };
  {
    ft::frame_tracker<ft::cuda_exec> tracker(backend.exec, rig(), params());
    give_images(tracker);
    ft::keypoints<ft::memory_space::device> const points(100);
    int* nowhere = nullptr;
    users_kernel<<<1, 1, 0, backend.exec.stream>>>(nowhere);  // writes where there is no memory
    expect_cuda_error([&] { backend.exec.wait(); });
    expect_cuda_error([&] {
      tracker.extract(backend.exec);
      backend.exec.wait();
    });
    expect_cuda_error(
        [&] { ft::frame_tracker<ft::cuda_exec> const another(backend.exec, rig(), params()); });
  }  // the destructors have nothing to say
  std::fprintf(stderr, "%d thrown\n", thrown);
  std::exit(thrown == 3 ? 0 : 1);
}

TEST(device_lifetime_DeathTest, a_fault_in_a_kernel_of_the_user_is_thrown_by_every_call_after_it) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  EXPECT_EXIT(fault_and_go_on(), ::testing::ExitedWithCode(0), "3 thrown");
}

#endif

}  // namespace lifetime_test

// SPDX-License-Identifier: Apache-2.0
// Images and blocks that an executor's threads fetch from host memory: every byte that is asked
// for, and none beside it; and which host memory they can read.
#include "ft/kernels/upload.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <random>
#include <string>
#include <thread>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/error.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/memory.hpp"
#include "ft/core/recording.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"
#if defined(__CUDACC__) && CUDART_VERSION >= 12050
#include <cuda.h>
#endif

namespace receive_test {

using test::at;

using bytes = std::vector<std::uint8_t>;

constexpr int quad = 16;
constexpr std::size_t guard = 256;  ///< bytes before and after what is written
constexpr std::uint8_t untouched = 0x5a;

int round_up(int n) { return (n + quad - 1) / quad * quad; }

bytes random_bytes(std::size_t count, std::mt19937& random) {
  bytes all(count);
  for (auto& b : all) { b = static_cast<std::uint8_t>(random()); }
  return all;
}

/// Host memory that the executor's threads read, with random contents.
template <typename Exec>
class source_memory {
public:
  source_memory(std::size_t count, std::mt19937& random)
      : contents(random_bytes(count, random)), memory_(count) {
    std::copy(contents.begin(), contents.end(), memory_.data());
  }
  /// Null for none.
  void const* address() const {
    return contents.empty() ? nullptr : Exec::host_address(memory_.data());
  }

  bytes const contents;

private:
  ft::buffer<std::uint8_t, ft::staging_space<Exec>> memory_;
};

/// Executor memory between two guards, all of it `untouched`.
template <typename Exec>
class guarded_memory {
public:
  guarded_memory(Exec const& exec, std::size_t count) : count_(count), memory_(count + 2 * guard) {
    ft::fill_bytes(exec, memory_.data(), untouched, memory_.bytes());
  }
  std::uint8_t* data() const { return memory_.data() + guard; }
  /// The whole, guards included, is `want` with guards around it.
  void expect(Exec const& exec, bytes want) const {
    ASSERT_EQ(want.size(), count_);
    want.insert(want.begin(), guard, untouched);
    want.insert(want.end(), guard, untouched);
    auto const got =
        test::from_exec(exec, static_cast<std::uint8_t const*>(memory_.data()), memory_.size());
    for (std::size_t i = 0; i < want.size(); ++i) {
      ASSERT_EQ(int{got[i]}, int{want[i]}) << "byte " << static_cast<std::ptrdiff_t>(i - guard);
    }
  }

private:
  std::size_t count_;
  ft::buffer<std::uint8_t, Exec::space> memory_;
};

/// A batch of images in host memory, each with a stride of its own, and a pyramid for them.
template <typename Exec>
class images {
public:
  images(Exec const& exec, int width, int height, int batch, unsigned seed)
      : geometry_(
            ft::pyramid_geometry::make(width, height, width > 40 && height > 40 ? 4 : 1, 1.2f)),
        batch_(batch),
        pyramid_(exec, at(geometry_.bytes) * at(batch)),
        list_(at(batch)) {
    std::mt19937 random(seed);
    for (int i = 0; i < batch; ++i) {
      int const stride = round_up(width) + quad * static_cast<int>(random() % 4u);
      strides_.push_back(stride);
      sources_.push_back(std::make_unique<source_memory<Exec>>(at(stride) * at(height), random));
      list_.data()[i] = {static_cast<std::uint8_t const*>(sources_.back()->address()), stride};
    }
  }
  ft::image_source* list() const { return list_.data(); }
  ft::image_pyramid_view pyramid() const {
    ft::image_pyramid_view v;
    v.geometry = geometry_;
    v.data = pyramid_.data();
    v.batch = batch_;
    return v;
  }
  /// Level 0 of image i is source `of(i)` from its first row on, in whole quads as far as the row
  /// reaches; nothing else was written.
  template <typename Which>
  void expect_received(Exec const& exec, Which const& of) const {
    auto const& g = geometry_;
    bytes want(at(g.bytes) * at(batch_), untouched);
    for (int i = 0; i < batch_; ++i) {
      auto const from = at(of(i));
      for (int y = list_.data()[i].first_row; y < g.height[0]; ++y) {
        auto const row =
            sources_[from]->contents.begin() + static_cast<std::ptrdiff_t>(y) * strides_[from];
        std::copy(row, row + round_up(g.width[0]),
                  want.begin() + i * g.bytes + static_cast<std::ptrdiff_t>(y) * g.stride[0]);
      }
    }
    pyramid_.expect(exec, want);
  }
  void expect_received(Exec const& exec) const {
    expect_received(exec, [](int i) { return i; });
  }
  void expect_untouched(Exec const& exec) const {
    pyramid_.expect(exec, bytes(at(geometry_.bytes) * at(batch_), untouched));
  }

private:
  ft::pyramid_geometry geometry_;
  int batch_;
  guarded_memory<Exec> pyramid_;
  std::vector<int> strides_;
  std::vector<std::unique_ptr<source_memory<Exec>>> sources_;
  ft::buffer<ft::image_source, ft::staging_space<Exec>> list_;
};

/// So many quads in host memory, and room for as many in the executor's.
template <typename Exec>
class block {
public:
  block(Exec const& exec, int quads, unsigned seed)
      : random_(seed), from_(at(quads) * quad, random_), to_(exec, at(quads) * quad) {}
  ft::block_source source() const {
    return {to_.data(), from_.address(), static_cast<int>(from_.contents.size() / quad)};
  }
  void expect_received(Exec const& exec) const { to_.expect(exec, from_.contents); }

private:
  std::mt19937 random_;
  source_memory<Exec> from_;
  guarded_memory<Exec> to_;
};

template <typename Backend>
class receive_unit : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  using images_type = images<exec_type>;
  using block_type = block<exec_type>;
  Backend backend;
};
TYPED_TEST_SUITE(receive_unit, test::backends);

TYPED_TEST(receive_unit, level_0_holds_every_pixel_and_nothing_else_is_written) {
  auto const& exec = this->backend.exec;
  struct size {
    int width, height, batch;
  };
  // Less than a quad, one, rows that end inside one, one row, one column, parts of 256 quads that
  // end with a row and inside one, more images than a fetcher holds the addresses of.
  std::vector<size> const sizes{{1, 1, 1},    {15, 7, 2},    {16, 1, 1},    {17, 3, 5},
                                {333, 1, 3},  {1, 300, 2},   {64, 64, 2},   {256, 16, 3},
                                {255, 17, 4}, {333, 257, 3}, {752, 480, 2}, {1241, 376, 1},
                                {20, 3, 300}};
  unsigned seed = 100;
  for (auto const& s : sizes) {
    SCOPED_TRACE(std::to_string(s.width) + "x" + std::to_string(s.height) + ", batch of " +
                 std::to_string(s.batch));
    typename TestFixture::images_type const all(exec, s.width, s.height, s.batch, seed++);
    ft::receive_images(exec, all.list(), all.pyramid());
    all.expect_received(exec);
    if (this->HasFatalFailure()) { return; }
  }
}

TYPED_TEST(receive_unit, blocks_arrive_whole_and_nothing_beyond_them) {
  auto const& exec = this->backend.exec;
  std::vector<int> const counts{0, 1, 2, 255, 256, 257, 511, 1000};
  unsigned seed = 200;
  for (int const first : counts) {
    for (int const second : counts) {
      SCOPED_TRACE(std::to_string(first) + " and " + std::to_string(second) + " quads");
      typename TestFixture::block_type const a(exec, first, seed++);
      typename TestFixture::block_type const b(exec, second, seed++);
      typename TestFixture::images_type const some(exec, 50, 9, 2, seed++);
      ft::receive_images(exec, some.list(), some.pyramid(), a.source(), b.source());
      some.expect_received(exec);
      a.expect_received(exec);
      b.expect_received(exec);
      if (this->HasFatalFailure()) { return; }
    }
  }
}

TYPED_TEST(receive_unit, blocks_come_without_images) {
  auto const& exec = this->backend.exec;
  for (int const second : {0, 300}) {
    typename TestFixture::block_type const a(exec, 700, 300);
    typename TestFixture::block_type const b(exec, second, 301);
    typename TestFixture::images_type const none(exec, 50, 9, 1, 302);
    auto pyramid = none.pyramid();
    pyramid.batch = 0;
    ft::receive_images(exec, nullptr, pyramid, a.source(), b.source());
    a.expect_received(exec);
    b.expect_received(exec);
    none.expect_untouched(exec);
  }
}

TYPED_TEST(receive_unit, nothing_to_fetch_writes_nothing) {
  auto const& exec = this->backend.exec;
  typename TestFixture::images_type const none(exec, 50, 9, 1, 400);
  auto pyramid = none.pyramid();
  pyramid.batch = 0;
  ft::receive_images(exec, nullptr, pyramid);
  none.expect_untouched(exec);
}

TYPED_TEST(receive_unit, a_recording_reads_where_the_images_lie_when_it_runs) {
  auto const& exec = this->backend.exec;
  typename TestFixture::images_type const all(exec, 100, 40, 3, 500);
  exec.wait();
  auto const queue = [&](auto const& e) { ft::receive_images(e, all.list(), all.pyramid()); };
  ft::recording<typename TestFixture::exec_type> recorded;
  recorded.record(exec, queue);
  recorded.replay(exec, queue);
  all.expect_received(exec);
  ft::image_source const first = all.list()[0];
  for (int i = 0; i < 2; ++i) { all.list()[i] = all.list()[i + 1]; }
  all.list()[2] = first;
  recorded.replay(exec, queue);
  all.expect_received(exec, [](int i) { return (i + 1) % 3; });
}

TYPED_TEST(receive_unit, leaves_the_rows_above_the_first_one_alone) {
  auto const& exec = this->backend.exec;
  for (int const height : {40, 200}) {
    typename TestFixture::images_type const all(exec, 100, height, 4, 700);
    exec.wait();
    all.list()[0].first_row = height - 1;
    all.list()[1].first_row = 7;
    all.list()[2].first_row = height;
    ft::receive_images(exec, all.list(), all.pyramid());
    all.expect_received(exec);
  }
}

// ---- which memory -----------------------------------------------------------------------------

TEST(host_address_unit, a_host_executor_reads_every_address_as_it_is) {
  bytes const memory(40);
  int const one = 1;
  EXPECT_EQ(ft::host_exec::host_address(memory.data() + 3), memory.data() + 3);
  EXPECT_EQ(ft::host_exec::host_address(&one), &one);
  EXPECT_EQ(ft::host_exec::host_address(nullptr), nullptr);
}

#if defined(__CUDACC__)

TEST(host_address_unit, memory_of_another_gpu_is_refused) {
  cudaPointerAttributes facts{};
  facts.type = cudaMemoryTypeDevice;
  facts.device = 1;
  EXPECT_NO_THROW(ft::detail::require_memory_of(1, facts));
  try {
    ft::detail::require_memory_of(0, facts);
    ADD_FAILURE() << "memory of GPU 1 was taken by GPU 0";
  } catch (ft::bad_argument const& e) {
    EXPECT_NE(std::string(e.what()).find("memory of GPU 1, and GPU 0"), std::string::npos);
  }
  for (auto const type : {cudaMemoryTypeUnregistered, cudaMemoryTypeHost, cudaMemoryTypeManaged}) {
    facts.type = type;
    EXPECT_NO_THROW(ft::detail::require_memory_of(0, facts));
  }
}

/// Reads through an address that the executor was given, byte by byte.
struct copy_byte {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, std::uint8_t const* from,
                                 std::uint8_t* to) const {
    to[item] = from[item];
  }
};

class host_address_of_a_device : public ::testing::Test {
protected:
  void SetUp() override {
    if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  }
  /// A kernel finds `want` at what host_address() says of `p`.
  static void expect_readable(void const* p, bytes const& want) {
    test::cuda_backend const backend;
    auto const* const from = static_cast<std::uint8_t const*>(ft::cuda_exec::host_address(p));
    ASSERT_NE(from, nullptr);
    ft::buffer<std::uint8_t, ft::memory_space::device> const to(want.size());
    ft::for_each_item<ft::per_thread>(backend.exec, static_cast<int>(want.size()), copy_byte{},
                                      from, to.data());
    EXPECT_EQ(
        test::from_exec(backend.exec, static_cast<std::uint8_t const*>(to.data()), want.size()),
        want);
  }
  static bytes some() {
    std::mt19937 random(600);
    return random_bytes(1000, random);
  }
};

TEST_F(host_address_of_a_device, threads_read_pinned_memory_also_from_its_middle) {
  bytes const want = some();
  ft::buffer<std::uint8_t, ft::memory_space::pinned> const memory(want.size());
  std::copy(want.begin(), want.end(), memory.data());
  expect_readable(memory.data(), want);
  expect_readable(memory.data() + 333, {want.begin() + 333, want.end()});
}

TEST_F(host_address_of_a_device, threads_read_registered_managed_and_device_memory) {
  bytes const want = some();
  bytes registered = want;
  ft::throw_on_error(
      cudaHostRegister(registered.data(), registered.size(), cudaHostRegisterDefault),
      "cudaHostRegister");
  expect_readable(registered.data(), want);
  ft::throw_on_error(cudaHostUnregister(registered.data()), "cudaHostUnregister");

  void* managed = nullptr;
  ft::throw_on_error(cudaMallocManaged(&managed, want.size()), "cudaMallocManaged");
  std::copy(want.begin(), want.end(), static_cast<std::uint8_t*>(managed));
  expect_readable(managed, want);
  ft::throw_on_error(cudaFree(managed), "cudaFree");

  test::cuda_backend const backend;
  auto const device = test::to_exec(backend.exec, want);
  expect_readable(device.data(), want);
}

TEST_F(host_address_of_a_device, memory_of_another_gpu_is_refused) {
  int gpus = 0;
  ft::throw_on_error(cudaGetDeviceCount(&gpus), "cudaGetDeviceCount");
  if (gpus < 2) { GTEST_SKIP() << "one GPU"; }
  int before = 0;
  ft::throw_on_error(cudaGetDevice(&before), "cudaGetDevice");
  ft::throw_on_error(cudaSetDevice((before + 1) % gpus), "cudaSetDevice");
  ft::buffer<std::uint8_t, ft::memory_space::device> const other(100);
  EXPECT_NE(ft::cuda_exec::host_address(other.data()), nullptr);
  ft::throw_on_error(cudaSetDevice(before), "cudaSetDevice");
  EXPECT_THROW(static_cast<void>(ft::cuda_exec::host_address(other.data())), ft::bad_argument);
}

TEST_F(host_address_of_a_device, ordinary_memory_has_none) {
  bytes const memory = some();
  int const one = 1;
  EXPECT_EQ(ft::cuda_exec::host_address(memory.data()), nullptr);
  EXPECT_EQ(ft::cuda_exec::host_address(&one), nullptr);
}

TEST_F(host_address_of_a_device, a_thread_that_is_new_to_the_device_is_told_the_same) {
  ft::buffer<std::uint8_t, ft::memory_space::pinned> const pinned(100);
  bytes const plain(100);
  void const* of_pinned = nullptr;
  void const* of_plain = &plain;
  std::thread([&] {
    of_pinned = ft::cuda_exec::host_address(pinned.data());
    of_plain = ft::cuda_exec::host_address(plain.data());
  }).join();
  EXPECT_EQ(of_pinned, ft::cuda_exec::host_address(pinned.data()));
  EXPECT_NE(of_pinned, nullptr);
  EXPECT_EQ(of_plain, nullptr);
}

#if CUDART_VERSION >= 12050

/// A function of the driver without linking to it, as it was in CUDA 11.3.
template <typename Function>
Function driver_function(char const* name) {
  void* p = nullptr;
  cudaDriverEntryPointQueryResult found{};
  ft::throw_on_error(cudaGetDriverEntryPointByVersion(name, &p, 11030, cudaEnableDefault, &found),
                     name);
  if (found != cudaDriverEntryPointSuccess || p == nullptr) {
    throw ft::cuda_error(std::string("no driver function ") + name);
  }
  return reinterpret_cast<Function>(p);
}

/// A context of the caller's own, current in this thread.
class pushed_context {
public:
  pushed_context() {
    int device = 0;
    ft::throw_on_error(cudaGetDevice(&device), "cudaGetDevice");
    auto const create =
        driver_function<CUresult (*)(CUcontext*, unsigned, CUdevice)>("cuCtxCreate");
    if (create(&context_, 0, device) != CUDA_SUCCESS) { throw ft::cuda_error("cuCtxCreate"); }
  }
  pushed_context(pushed_context const&) = delete;
  pushed_context& operator=(pushed_context const&) = delete;
  ~pushed_context() { driver_function<CUresult (*)(CUcontext)>("cuCtxDestroy")(context_); }

  bool is_current() const {
    CUcontext now = nullptr;
    return driver_function<CUresult (*)(CUcontext*)>("cuCtxGetCurrent")(&now) == CUDA_SUCCESS &&
           now == context_;
  }

private:
  CUcontext context_ = nullptr;
};

TEST_F(host_address_of_a_device, a_context_that_the_caller_pushed_stays) {
  ft::buffer<std::uint8_t, ft::memory_space::pinned> const pinned(100);
  bytes const plain(100);
  void const* const before = ft::cuda_exec::host_address(pinned.data());
  pushed_context const own;
  ASSERT_TRUE(own.is_current());
  EXPECT_EQ(ft::cuda_exec::host_address(pinned.data()), before);
  EXPECT_TRUE(own.is_current());
  EXPECT_EQ(ft::cuda_exec::host_address(plain.data()), nullptr);
  EXPECT_TRUE(own.is_current());
}

#endif
#endif

}  // namespace receive_test

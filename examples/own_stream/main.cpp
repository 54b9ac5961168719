// SPDX-License-Identifier: Apache-2.0
// ft on a user's stream, concurrent with other work on the GPU. One stream makes the images (a
// kernel brightens them), ft extracts on a second one, an event orders the two, and a third stream
// is busy all the time. ft waits only for work on its own stream.
#include <cstdint>
#include <cstdio>
#include <vector>

#include "examples/common/run.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/memory.hpp"
#include "ft/pipelines/orb_extractor.hpp"

constexpr int images = 8;

__global__ void brighten(std::uint8_t const* from, std::uint8_t* to, int pixels, int by) {
  int const i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  if (i < pixels) { to[i] = static_cast<std::uint8_t>(from[i] + by < 255 ? from[i] + by : 255); }
}

/// Some other work that keeps a stream busy.
__global__ void other_work(float* values, int steps) {
  int const i = static_cast<int>(blockIdx.x * blockDim.x + threadIdx.x);
  float v = values[i];
  for (int k = 0; k < steps; ++k) { v = v * 0.999f + 0.001f; }
  values[i] = v;
}

/// Keypoints of `images` images, each brighter than the preceding one.
/// @param meanwhile called after each image is enqueued
template <typename Meanwhile>
std::vector<int> keypoint_counts(ft::cuda_exec const& exec, demo::grey_image const& image,
                                 Meanwhile const& meanwhile) {
  int const pixels = image.width * image.height;
  auto const bytes = static_cast<std::size_t>(pixels);
  ft::stream const source;
  ft::event const ready;
  ft::event const taken;
  ft::buffer<std::uint8_t, ft::memory_space::device> const original(bytes);
  ft::buffer<std::uint8_t, ft::memory_space::device> const bright(bytes);
  ft::buffer<int, ft::memory_space::pinned> const counts(images);
  ft::orb_extractor<ft::cuda_exec> orb(exec, demo::params_for(image), 1);
  ft::copy(ft::cuda_exec(source.get()), original.data(), image.pixels.data(), bytes);

  for (int k = 0; k < images; ++k) {
    // The kernel must not write before ft has read the preceding image.
    taken.make_wait(source.get());
    brighten<<<(pixels + 255) / 256, 256, 0, source.get()>>>(original.data(), bright.data(), pixels,
                                                             4 * k);
    ft::throw_on_error(cudaGetLastError(), "brighten");
    ready.record(source.get());

    // Later work on ft's stream runs after the kernel. An image may be in device memory: the copy
    // is then from device to device.
    ready.make_wait(exec.stream);
    orb.upload(exec, 0, {bright.data(), image.width, image.height, image.width});
    taken.record(exec.stream);
    orb.extract(exec);
    ft::copy(exec, counts.data() + k, static_cast<int const*>(orb.keypoints().count), 1);
    meanwhile();
  }
  exec.wait();  // waits only for ft's stream
  return std::vector<int>(counts.data(), counts.data() + images);
}

int main() {
  return demo::run([](ft::cuda_exec const& exec) {
    auto const image = demo::scene(100).render(60).left;
    auto const alone = keypoint_counts(exec, image, [] {});

    ft::stream const busy;
    constexpr int threads = 64 * 256;
    ft::buffer<float, ft::memory_space::device> const values(threads);
    ft::fill_bytes(ft::cuda_exec(busy.get()), values.data(), 0, values.bytes());
    auto const concurrent = keypoint_counts(exec, image, [&] {
      other_work<<<64, 256, 0, busy.get()>>>(values.data(), 10000000);
      ft::throw_on_error(cudaGetLastError(), "other_work");
    });
    bool const still_busy = cudaStreamQuery(busy.get()) == cudaErrorNotReady;
    ft::cuda_exec(busy.get()).wait();

    bool same = true;
    for (int k = 0; k < images; ++k) {
      auto const i = static_cast<std::size_t>(k);
      same = same && alone[i] == concurrent[i] && alone[i] > 500;
    }
    std::printf("%d images, keypoints %s; the other stream was %s when ft's was done\n", images,
                same ? "as without other work" : "DIFFER", still_busy ? "still busy" : "done");
    return demo::verdict(same);
  });
}

// SPDX-License-Identifier: Apache-2.0
// A container with a user-defined field, filled by a user-defined stage and sorted by Thrust: the
// strongest keypoint of each tile of the image. Thrust comes with the CUDA toolkit, so only nvcc
// compiles this example. It runs on the host, and on a GPU if one is found.
#include <thrust/execution_policy.h>
#include <thrust/sort.h>
#include <thrust/unique.h>

#include <cstdio>

#include "examples/common/run.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/containers/soa.hpp"
#include "ft/interop/thrust.hpp"
#include "ft/pipelines/orb_extractor.hpp"

/// A field names a column and the type of its elements; the container has one array for each field.
FT_FIELD(tile, int);  ///< number of the image's tile, row by row
using tiled_view = ft::soa_view<ft::field::x, ft::field::y, ft::field::response, tile>;
template <ft::memory_space Space>
using tiled_keypoints = ft::soa<Space, ft::field::x, ft::field::y, ft::field::response, tile>;

constexpr int tile_size = 80;  // pixels

/// A stage: the work for one item. The executor runs it for all items, on threads or on a GPU.
struct assign_tile {
  using scratch = ft::no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, tiled_view const& keypoints,
                                 int tiles_per_row) const {
    int const column = static_cast<int>(keypoints.x(i)) / tile_size;
    int const row = static_cast<int>(keypoints.y(i)) / tile_size;
    keypoints.tile(i) = row * tiles_per_row + column;
  }
};

auto thrust_policy(ft::host_exec const&) { return thrust::host; }
auto thrust_policy(ft::cuda_exec const& exec) { return thrust::cuda::par.on(exec.stream); }

/// By tile, then the strongest first, then by position, so that the order is the same everywhere.
struct in_front {
  template <typename A, typename B>  // tuples of values or of references
  FT_HOST_DEVICE bool operator()(A const& a, B const& b) const {
    if (thrust::get<0>(a) != thrust::get<0>(b)) { return thrust::get<0>(a) < thrust::get<0>(b); }
    if (thrust::get<1>(a) != thrust::get<1>(b)) { return thrust::get<1>(a) > thrust::get<1>(b); }
    if (thrust::get<2>(a) != thrust::get<2>(b)) { return thrust::get<2>(a) < thrust::get<2>(b); }
    return thrust::get<3>(a) < thrust::get<3>(b);
  }
};
struct same_tile {
  template <typename A, typename B>  // tuples of values or of references
  FT_HOST_DEVICE bool operator()(A const& a, B const& b) const {
    return thrust::get<0>(a) == thrust::get<0>(b);
  }
};

/// @return the sum of the responses kept, or -1 on an error
template <typename Exec>
double strongest_of_tiles(Exec const& exec, demo::grey_image const& image) {
  ft::orb_extractor<Exec> orb(exec, demo::params_for(image), 1);
  orb.upload(exec, 0, demo::view(image));
  orb.extract(exec);

  // A view of more fields converts to one of fewer, so the plain columns can be copied.
  using plain = ft::soa_view<ft::field::x, ft::field::y, ft::field::response>;
  tiled_keypoints<Exec::space> const mine(orb.capacity());
  ft::copy(exec, plain(mine.view()), plain(orb.keypoints()));

  int count = 0;  // Thrust needs the count on the host
  ft::copy(exec, &count, mine.view().count, 1);
  exec.wait();
  ft::for_each_item<ft::per_thread>(exec, count, assign_tile{}, mine.view(),
                                    (image.width + tile_size - 1) / tile_size);

  // zip_begin makes tuples of columns. Thrust works on the same stream, after the stage.
  auto const policy = thrust_policy(exec);
  auto const first =
      ft::zip_begin<tile, ft::field::response, ft::field::x, ft::field::y>(mine.view());
  thrust::sort(policy, first, first + count, in_front{});
  auto const last = thrust::unique(policy, first, first + count, same_tile{});
  int const kept = static_cast<int>(last - first);

  auto const found = ft::download(exec, mine.view());
  double sum = 0;
  bool rising = true;
  for (int i = 0; i < kept; ++i) {
    sum += static_cast<double>(found.view().response(i));
    rising = rising && (i == 0 || found.view().tile(i - 1) < found.view().tile(i));
  }
  std::printf("%d keypoints, the strongest of %d tiles, responses add up to %.0f\n", count, kept,
              sum);
  return rising && kept > 20 && kept < count ? sum : -1;
}

int main() {
  return demo::guarded([] {
    auto const image = demo::scene(100).render(60).left;
    double const host = strongest_of_tiles(ft::host_exec(), image);
    if (!demo::has_device()) {
      std::puts("no CUDA device was found: run on the host alone");
      return demo::verdict(host > 0);
    }
    ft::stream const mine;
    return demo::verdict(host > 0 && strongest_of_tiles(ft::cuda_exec(mine.get()), image) == host);
  });
}

// SPDX-License-Identifier: Apache-2.0
/// @file What a stranger's first program looks like: a stage of one's own over a container of ft's.
/// Every consumer project builds it, as C++ or as CUDA.
#include <ft/stages.hpp>

#include <cstdio>

struct double_x {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i,
                                 ft::soa_view<ft::field::x> const& v) const {
    v.x(i) *= 2;
  }
};

int main() {
  ft::soa<ft::memory_space::host, ft::field::x, ft::field::y> points(1000);
  for (int i = 0; i < 1000; ++i) { points.view().x(i) = static_cast<float>(i); }
  ft::soa_view<ft::field::x> const columns = points.view();
  ft::for_each_item<ft::per_thread>(ft::host_exec(), 1000, double_x{}, columns);
  bool good = true;
  for (int i = 0; i < 1000; ++i) { good = good && points.view().x(i) == static_cast<float>(2 * i); }
  std::printf("ft %d.%d.%d, C++ %ld\n", ft::version_major, ft::version_minor, ft::version_patch,
              static_cast<long>(__cplusplus));
  return good ? 0 : 1;
}

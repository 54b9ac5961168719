// SPDX-License-Identifier: Apache-2.0
// A descriptor of one's own: 128 comparisons of grey values around a keypoint. The model is what
// ft asks of it, a stage computes it at ORB's keypoints, and match_descriptors() matches a
// rectified pair with it, where correct matches lie in the same row.
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <type_traits>

#include "examples/common/run.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/bits.hpp"
#include "ft/descriptors/descriptor_model.hpp"
#include "ft/kernels/matching/match_descriptors.hpp"
#include "ft/pipelines/orb_extractor.hpp"

/// A descriptor: its bits, their distance, and what distances are like.
struct patch_bits {
  static constexpr char const* name = "patch_bits";
  /// From 0 to 128 bits; 24 are near; clear is below 4 / 5 of the second best.
  static constexpr ft::descriptor_rules<int> rules{0, 128, 24, 4, 5};
  std::uint32_t words[4];

  FT_HOST_DEVICE static int distance(patch_bits const& a, patch_bits const& b) {
    int differ = 0;
    for (int i = 0; i < 4; ++i) { differ += ft::popcount(a.words[i] ^ b.words[i]); }
    return differ;
  }
};
static_assert(ft::assert_descriptor_model<patch_bits>::value, "patch_bits keeps the contract");

/// A stage: the descriptor of a keypoint. Bit k compares two places up to 12 pixels away.
struct describe_patch {
  using scratch = ft::no_scratch;

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, ft::gray_view const& image,
                                 ft::keypoints_view const& keypoints, patch_bits* out) const {
    patch_bits bits{};
    if (i < *keypoints.count) {
      auto const x = static_cast<int>(keypoints.x(i)), y = static_cast<int>(keypoints.y(i));
      std::uint32_t random = 1;
      auto const offset = [&] {
        random = random * 1664525u + 1013904223u;
        return static_cast<int>(random >> 16) % 25 - 12;
      };
      auto const grey = [&](int u, int v) {  // of 3 by 3 pixels
        int sum = 0;
        for (int k = 0; k < 9; ++k) {
          int const column = ft::clamp(u + k % 3 - 1, 0, image.width - 1);
          sum += image.data[ft::clamp(v + k / 3 - 1, 0, image.height - 1) * image.stride + column];
        }
        return sum;
      };
      for (int k = 0; k < 128; ++k) {
        int const u = x + offset(), v = y + offset(), s = x + offset(), t = y + offset();
        bits.words[k / 32] |= static_cast<std::uint32_t>(grey(u, v) < grey(s, t)) << k % 32;
      }
    }
    out[i] = bits;
  }
};

int main() {
  return demo::run([](auto const& exec) {
    using exec_type = std::decay_t<decltype(exec)>;
    constexpr auto space = exec_type::space;
    auto const pair = demo::scene(100).render(60);
    ft::orb_extractor<exec_type> orb(exec, demo::params_for(pair.left), 2);
    int const capacity = orb.capacity();
    ft::buffer<std::uint8_t, space> const pixels(pair.left.pixels.size());
    auto const rows = static_cast<std::size_t>(orb.capacity());
    ft::buffer<patch_bits, space> const left(rows), right(rows);
    auto const describe = [&](int camera, demo::grey_image const& image, patch_bits* out) {
      ft::copy(exec, pixels.data(), image.pixels.data(), image.pixels.size());
      ft::gray_view const there{pixels.data(), image.width, image.height, image.width};
      ft::for_each_item<ft::per_thread>(exec, capacity, describe_patch{}, there,
                                        orb.keypoints().slice(camera), out);
    };
    orb.upload(exec, 0, demo::view(pair.left));
    orb.upload(exec, 1, demo::view(pair.right));
    orb.extract(exec);
    describe(0, pair.left, left.data());
    describe(1, pair.right, right.data());

    using workspace = ft::match_workspace<int>;
    ft::owner<workspace, space> const work(
        [&](ft::carver& c, workspace& v) { carve(c, v, capacity, capacity); });
    ft::buffer<ft::descriptor_match<int>, space> const matches(rows);
    ft::descriptor_rows<patch_bits> const query{left.data(), capacity,
                                                orb.keypoints().slice(0).count};
    ft::descriptor_rows<patch_bits> const train{right.data(), capacity,
                                                orb.keypoints().slice(1).count};
    ft::match_descriptors(exec, query, train, ft::match_tests<int>::by(patch_bits::rules, true),
                          work.view(), matches.data());

    ft::buffer<ft::descriptor_match<int>, ft::memory_space::host> const found(matches.size());
    ft::copy(exec, found.data(), matches.data(), matches.size());
    auto const keypoints = ft::download(exec, orb.keypoints());  // waits
    auto const l = keypoints.view().slice(0), r = keypoints.view().slice(1);
    int accepted = 0, same_row = 0;
    for (int i = 0; i < *l.count; ++i) {
      int const j = found.data()[i].index;
      accepted += static_cast<int>(j >= 0);
      same_row += static_cast<int>(j >= 0 && std::abs(l.y(i) - r.y(j)) < 3);
    }
    std::printf("%d and %d keypoints, %d matches, %d of them in the same row\n", *l.count, *r.count,
                accepted, same_row);
    return demo::verdict(accepted > 150 && same_row > 0.95 * accepted);
  });
}

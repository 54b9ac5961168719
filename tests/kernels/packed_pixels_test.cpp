// SPDX-License-Identifier: Apache-2.0
// What a device does with several pixels at a time, against one pixel at a time: the helpers, the
// corner test and score of pairs, and the blur by strips. The same source runs on both executors.
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <random>
#include <utility>
#include <vector>

#include "ft/containers/image_pyramid.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/blur.hpp"
#include "ft/kernels/corners/detail/fast_score.hpp"
#include "ft/kernels/corners/detect_corners.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace packed_pixels_test {

using test::at;
using test::noise;

using word = std::uint32_t;
using image = std::vector<std::uint8_t>;

template <typename Backend>
class packed_pixels_unit : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(packed_pixels_unit, test::backends);

struct operands {
  word a, b, c;
};
struct results {
  word min, max, swapped, permuted, selected, dot4, dot2, difference, differences, shifted;
};
struct apply_all {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, operands const* in, results* out) const {
    auto const [a, b, c] = in[i];
    out[i] = {ft::detail::min_pairs(a, b),
              ft::detail::max_pairs(a, b),
              ft::detail::swap_pair(a),
              ft::detail::permute_bytes(a, b, c & 0x7777u),
              ft::detail::select_bytes(a, b, c & 0x77777777u),
              ft::detail::dot_of_4(a, b, c >> 8),
              ft::detail::dot_of_2(a, b, c >> 8),
              ft::detail::difference_of_4(a, b, c >> 8),
              ft::detail::differences_of_4(a, b),
              ft::detail::bytes_from(a, b, static_cast<int>(c & 3u))};
  }
};

TYPED_TEST(packed_pixels_unit, operations_on_words_are_those_on_their_parts) {
  std::mt19937 random(5);
  std::vector<operands> in;
  for (int i = 0; i < 5000; ++i) {
    in.push_back(
        {static_cast<word>(random()), static_cast<word>(random()), static_cast<word>(random())});
  }
  in.push_back({0, 0xffffffffu, 0x7654});
  in.push_back({0xffff0000u, 0x0000ffffu, 0});
  in.push_back({0xffffffffu, 0xffffffffu, 0x00ffffffu});
  auto const d_in = test::to_exec(this->backend.exec, in);
  auto d_out = test::to_exec(this->backend.exec, std::vector<results>(in.size()));
  ft::for_each_item<ft::per_thread>(this->backend.exec, static_cast<int>(in.size()), apply_all{},
                                    d_in.data(), d_out.data());
  auto const out = test::from_exec(this->backend.exec, d_out);
  for (std::size_t i = 0; i < in.size(); ++i) {
    auto const [a, b, c] = in[i];
    auto const halved = [](word v, int k) { return v >> (16 * k) & 0xffffu; };
    auto const byte = [](word v, int k) { return v >> (8 * k) & 0xffu; };
    word dot4 = c >> 8;
    word permuted = 0;
    for (int k = 0; k < 4; ++k) {
      dot4 += byte(a, k) * byte(b, k);
      int const from = static_cast<int>(c >> (4 * k) & 7u);
      permuted |= (from < 4 ? byte(a, from) : byte(b, from - 4)) << (8 * k);
    }
    EXPECT_EQ(out[i].min,
              std::min(halved(a, 0), halved(b, 0)) + (std::min(halved(a, 1), halved(b, 1)) << 16));
    EXPECT_EQ(out[i].max,
              std::max(halved(a, 0), halved(b, 0)) + (std::max(halved(a, 1), halved(b, 1)) << 16));
    EXPECT_EQ(out[i].swapped, halved(a, 1) + (halved(a, 0) << 16));
    EXPECT_EQ(out[i].permuted, permuted);
    EXPECT_EQ(out[i].selected, permuted);
    EXPECT_EQ(out[i].dot4, dot4);
    EXPECT_EQ(out[i].dot2, (c >> 8) + halved(a, 0) * byte(b, 0) + halved(a, 1) * byte(b, 1));
    word difference = c >> 8;
    word differences = 0;
    word shifted = 0;
    for (int k = 0; k < 4; ++k) {
      word const of_byte = std::max(byte(a, k), byte(b, k)) - std::min(byte(a, k), byte(b, k));
      difference += of_byte;
      differences |= of_byte << (8 * k);
      int const from = k + static_cast<int>(c & 3u);
      shifted |= (from < 4 ? byte(a, from) : byte(b, from - 4)) << (8 * k);
    }
    EXPECT_EQ(out[i].difference, difference);
    EXPECT_EQ(out[i].differences, differences);
    EXPECT_EQ(out[i].shifted, shifted);
  }
}

struct three_words {
  word of[3];
};
struct load_three {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int i, std::uint8_t const* pixels,
                                 three_words* out) const {
    int const bytes = 9 + i % 4;
    ft::detail::load_bytes(pixels + 20 - bytes - i / 4, bytes, out[i].of);
  }
};

TYPED_TEST(packed_pixels_unit, bytes_are_read_from_any_address_up_to_the_last_word) {
  // They end before each of the last four; what is there are whole words, and no more.
  auto const pixels = noise(20, 9);
  constexpr int items = 16;
  auto const d_pixels = test::to_exec(this->backend.exec, pixels);
  auto d_out = test::to_exec(this->backend.exec, std::vector<three_words>(items));
  ft::for_each_item<ft::per_thread>(this->backend.exec, items, load_three{}, d_pixels.data(),
                                    d_out.data());
  auto const out = test::from_exec(this->backend.exec, d_out.data(), at(items));
  for (int i = 0; i < items; ++i) {
    int const bytes = 9 + i % 4;
    for (int k = 0; k < bytes; ++k) {
      EXPECT_EQ(out[at(i)].of[k / 4] >> (8 * (k % 4)) & 0xffu, pixels[at(20 - bytes - i / 4 + k)])
          << i << ", " << k;
    }
  }
}

TEST(small_divider_unit, is_the_quotient) {
  for (int n = 1; n < 3000; n += 1 + n / 40) {
    ft::detail::small_divider const divide(n);
    for (int i = 0; i < 20000; i += 1 + i % 7) { ASSERT_EQ(divide(i), i / n) << i << " / " << n; }
    for (int q = 1; q * n < 20000; ++q) {
      ASSERT_EQ(divide(q * n), q);
      ASSERT_EQ(divide(q * n - 1), q - 1);
    }
  }
}

struct rectangle {
  int x, y, w, h, pitch;
};
/// Copies a rectangle through scratch. The image starts `shift` bytes after an aligned address.
struct stage_and_copy {
  static constexpr int most = 4096;
  struct scratch {
    word words[most];
  };
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, ft::gray_view from, rectangle const& r,
                                 std::uint8_t* to) const {
    ft::detail::stage_rectangle(g, from, {r.x, r.y, r.w, r.h}, s.words, r.pitch);
    g.sync();
    auto const* const bytes = reinterpret_cast<std::uint8_t const*>(s.words);
    for (int i = g.rank(); i < r.w * r.h; i += g.size()) {
      to[i] = bytes[i / r.w * r.pitch * 4 + (r.x & 3) + i % r.w];
    }
  }
};

TYPED_TEST(packed_pixels_unit, rectangles_reach_scratch_from_any_address_and_stride) {
  std::mt19937 random(9);
  auto const below = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  for (int round = 0; round < 60; ++round) {
    int const width = 1 + below(120);
    int const height = 1 + below(70);
    int const shift = round % 2 == 0 ? 0 : below(4);
    int const stride = round % 3 == 0 ? width + below(5) : (width + 3) / 4 * 4 + 4 * below(4);
    image const pixels = noise(at(shift + stride * height), static_cast<unsigned>(round));
    rectangle r{below(width), below(height), 0, 0, 0};
    r.w = below(width - r.x + 1);
    r.h = below(height - r.y + 1);
    r.pitch = (r.w + 6) / 4 + below(3);
    ASSERT_LE(r.pitch * r.h, stage_and_copy::most);
    auto const d_pixels = test::to_exec(this->backend.exec, pixels);
    auto d_out = test::to_exec(this->backend.exec, image(at(r.w * r.h) + 1));
    ft::gray_view const view{d_pixels.data() + shift, width, height, stride};
    ft::for_each_item<ft::per_block<64>>(this->backend.exec, 1, stage_and_copy{}, view, r,
                                         d_out.data());
    auto const out = test::from_exec(this->backend.exec, d_out.data(), at(r.w * r.h));
    for (int i = 0; i < r.w * r.h; ++i) {
      ASSERT_EQ(out[at(i)], pixels[at(shift + (r.y + i / r.w) * stride + r.x + i % r.w)])
          << "round " << round << " pixel " << i;
    }
  }
}

/// One row of words: flagged pixels as a list.
struct list_flagged {
  struct scratch {
    int count;
    std::uint16_t list[512];
  };
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int, unsigned const* flags, int n,
                                 int capacity, int* count, std::uint16_t* to) const {
    if (g.rank() == 0) { s.count = 0; }
    for (int i = g.rank(); i < 512; i += g.size()) { s.list[i] = 0xffff; }
    g.sync();
    for (int base = 0; base < n; base += g.size()) {
      int const i = base + g.rank();
      ft::detail::append_flagged(
          g, i < n ? flags[i] : 0u, [&](unsigned bit) { return 12 * i + static_cast<int>(bit); },
          s.list, capacity, &s.count);
    }
    g.sync();
    for (int i = g.rank(); i < 512; i += g.size()) { to[i] = s.list[i]; }
    if (g.rank() == 0) { *count = s.count; }
  }
};

TYPED_TEST(packed_pixels_unit, flagged_pixels_are_listed_once_and_counted_past_the_end) {
  std::mt19937 random(3);
  for (int const n : {0, 1, 31, 32, 33, 64, 100, 200}) {
    for (int const share : {0, 1, 3, 8}) {
      std::vector<unsigned> flags(at(n) + 1);
      std::vector<std::uint16_t> want;
      for (int i = 0; i < n; ++i) {
        for (int k = 0; k < 12; ++k) {
          if (static_cast<int>(random() % 8) >= share) { continue; }
          flags[at(i)] |= 1u << k;
          want.push_back(static_cast<std::uint16_t>(12 * i + k));
        }
      }
      int const capacity = 300;
      auto const d_flags = test::to_exec(this->backend.exec, flags);
      auto d_count = test::to_exec(this->backend.exec, std::vector<int>(1));
      auto d_list = test::to_exec(this->backend.exec, std::vector<std::uint16_t>(512));
      ft::for_each_item<ft::per_block<64>>(this->backend.exec, 1, list_flagged{}, d_flags.data(), n,
                                           capacity, d_count.data(), d_list.data());
      auto const count = test::from_exec(this->backend.exec, d_count)[0];
      auto list = test::from_exec(this->backend.exec, d_list);
      EXPECT_EQ(count, static_cast<int>(want.size()));
      for (std::size_t i = at(capacity); i < list.size(); ++i) { EXPECT_EQ(list[i], 0xffff) << i; }
      if (count > capacity) { continue; }
      list.resize(want.size());
      std::sort(list.begin(), list.end());
      EXPECT_EQ(list, want);
    }
  }
}

/// True where `mask` (16 bits, cyclic) has 9 ones in a row.
bool has_arc_of_9(unsigned mask) {
  unsigned const twice = mask | mask << 16;
  for (int k = 0; k < 16; ++k) {
    if ((twice >> k & 0x1ffu) == 0x1ffu) { return true; }
  }
  return false;
}

/// The score by its definition: the largest threshold at which the pixel still is a corner.
int score_by_definition(std::uint8_t const* center, ft::detail::fast_circle const& circle,
                        int threshold) {
  auto const is_corner = [&](int t) {
    unsigned bright = 0;
    unsigned dark = 0;
    for (int k = 0; k < 16; ++k) {
      int const d = center[circle.offset[k]] - center[0];
      bright |= static_cast<unsigned>(d > t) << k;
      dark |= static_cast<unsigned>(d < -t) << k;
    }
    return has_arc_of_9(bright) || has_arc_of_9(dark);
  };
  if (!is_corner(threshold)) { return 0; }
  int t = threshold;
  while (is_corner(t + 1)) { ++t; }
  return t;
}

/// Flags and scores of pairs, per pixel of an image whose stride is detect_cell's.
struct score_all {
  using scratch = ft::no_scratch;
  /// Whether of both opposite pairs on the axes one differs enough: a bit per pixel of the word.
  FT_HOST_DEVICE static unsigned corner_flags(std::uint8_t const* p, int threshold) {
    constexpr int three_rows = 3 * ft::detail::cell_pitch;
    word const rest = ft::detail::threshold_rest(threshold);
    word const middle = ft::detail::load_word(p);
    auto const exceeding = [&](word other) {
      return ft::detail::exceeding(ft::detail::differences_of_4(other, middle), rest);
    };
    word const beside =
        exceeding(ft::detail::permute_bytes(ft::detail::load_word(p - 4), middle, 0x4321)) |
        exceeding(ft::detail::permute_bytes(middle, ft::detail::load_word(p + 4), 0x6543));
    word const vertical = exceeding(ft::detail::load_word(p - three_rows)) |
                          exceeding(ft::detail::load_word(p + three_rows));
    return (beside & vertical & 0x80808080u) * 0x00204081u >> 28;
  }
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, std::uint8_t const* pixels, int width,
                                 int threshold, int* scores, int* flags) const {
    constexpr int pitch = ft::detail::cell_pitch;
    int const y = 3 + item / (width / 4 - 2);
    int const x = 4 + item % (width / 4 - 2) * 4;
    std::uint8_t const* const p = pixels + y * pitch + x;
    unsigned const four = corner_flags(p, threshold);
    constexpr ft::detail::fast_circle circle(pitch);
    for (int k = 0; k < 4; ++k) {
      flags[y * pitch + x + k] = static_cast<int>(four >> k & 1u);
      scores[y * pitch + x + k] = ft::detail::fast_score_of_pairs(p + k, circle, threshold);
    }
  }
};

TYPED_TEST(packed_pixels_unit, corner_test_and_score_of_pairs_are_those_of_single_pixels) {
  constexpr int pitch = ft::detail::cell_pitch;
  constexpr int height = 60;
  constexpr ft::detail::fast_circle circle(pitch);
  int corners = 0;
  for (int const threshold : {0, 1, 7, 20, 100, 254, 255}) {
    for (unsigned kind = 0; kind < 3; ++kind) {
      image pixels = kind == 0 ? noise(at(pitch * height), 40u + static_cast<unsigned>(threshold))
                               : test::random_image(pitch, height, kind);
      if (kind == 2) {
        for (auto& p : pixels) { p = p < 128 ? std::uint8_t{0} : std::uint8_t{255}; }
      }
      auto const d_pixels = test::to_exec(this->backend.exec, pixels);
      auto d_scores = test::to_exec(this->backend.exec, std::vector<int>(pixels.size()));
      auto d_flags = test::to_exec(this->backend.exec, std::vector<int>(pixels.size()));
      ft::for_each_item<ft::per_thread>(this->backend.exec, (height - 6) * (pitch / 4 - 2),
                                        score_all{}, d_pixels.data(), pitch, threshold,
                                        d_scores.data(), d_flags.data());
      auto const scores = test::from_exec(this->backend.exec, d_scores);
      auto const flags = test::from_exec(this->backend.exec, d_flags);
      for (int y = 3; y < height - 3; ++y) {
        for (int x = 4; x < pitch - 4; ++x) {
          int const i = y * pitch + x;
          std::uint8_t const* const p = pixels.data() + i;
          int const want = score_by_definition(p, circle, threshold);
          ASSERT_EQ(scores[at(i)], want) << x << " " << y << " threshold " << threshold;
          corners += static_cast<int>(want > 0);
          ASSERT_TRUE(want == 0 || flags[at(i)] != 0);
          // A byte's carry lets pass what is equal to the threshold.
          int exceed = 0;
          int reach = 0;
          int const pairs[2][2] = {{p[3 * pitch], p[-3 * pitch]}, {p[3], p[-3]}};
          for (auto const& pair : pairs) {
            int const most = std::max(std::abs(pair[0] - p[0]), std::abs(pair[1] - p[0]));
            exceed += static_cast<int>(most > std::min(threshold, 127));
            reach += static_cast<int>(most >= std::min(threshold, 127));
          }
          ASSERT_TRUE(exceed < 2 || flags[at(i)] != 0);
          ASSERT_TRUE(reach == 2 || flags[at(i)] == 0);
        }
      }
    }
  }
  EXPECT_GT(corners, 1000);
}

TEST(corner_runs, scores_of_runs_are_those_of_single_pixels) {
  constexpr int run = ft::detail::run_pixels;
  constexpr int stride = 80;
  constexpr int height = 40;
  constexpr ft::detail::fast_circle circle(stride);
  int corners = 0;
  for (int const threshold : {0, 1, 7, 20, 100, 254, 255}) {
    for (unsigned kind = 0; kind < 3; ++kind) {
      image pixels = kind == 0 ? noise(at(stride * height), 90u + static_cast<unsigned>(threshold))
                               : test::random_image(stride, height, kind);
      if (kind == 2) {
        for (auto& p : pixels) { p = p < 128 ? std::uint8_t{0} : std::uint8_t{255}; }
      }
      for (int y = 3; y < height - 3; ++y) {
        for (int x : {3, 4, stride - 3 - run}) {
          std::uint8_t const* const p = pixels.data() + y * stride + x;
          std::uint8_t scores[run];
          ft::detail::score_run(p, stride, static_cast<std::uint8_t>(threshold), scores);
          for (int k = 0; k < run; ++k) {
            int const want = score_by_definition(p + k, circle, threshold);
            ASSERT_EQ(int{scores[k]}, want) << x + k << " " << y << " threshold " << threshold;
            corners += static_cast<int>(want > 0);
          }
        }
      }
    }
  }
  EXPECT_GT(corners, 1000);
}

TEST(corner_runs, what_does_not_exceed_its_eight_neighbours_is_suppressed) {
  constexpr int run = ft::detail::run_pixels;
  constexpr int pitch = run + 2;
  std::mt19937 random(5);
  for (int trial = 0; trial < 50; ++trial) {
    image scores(3 * pitch);
    for (auto& s : scores) { s = static_cast<std::uint8_t>(random() % (trial < 25 ? 4u : 256u)); }
    ft::detail::run_of_scores const kept =
        ft::detail::suppress_run(scores.data() + pitch + 1, pitch);
    for (int k = 0; k < run; ++k) {
      int const own = scores[at(pitch + 1 + k)];
      bool highest = true;
      for (int n : {0, 1, 2, pitch, pitch + 2, 2 * pitch, 2 * pitch + 1, 2 * pitch + 2}) {
        highest = highest && own > scores[at(n + k)];
      }
      ASSERT_EQ(int{kept.of[k]}, highest ? own : 0) << k;
    }
  }
}

struct note_place {
  int* places;
  int* count;
  FT_HOST_DEVICE void operator()(int k) const { places[(*count)++] = k; }
};

TEST(corner_runs, every_number_from_the_threshold_on_is_visited_in_order) {
  constexpr int run = ft::detail::run_pixels;
  std::mt19937 random(6);
  for (int const threshold : {1, 7, 128, 255}) {
    std::uint8_t values[run];
    std::vector<int> want;
    int seen[run];
    int count = 0;
    for (int k = 0; k < run; ++k) {
      int const near = threshold + static_cast<int>(random() % 3) - 1;
      values[k] = static_cast<std::uint8_t>(std::min(near, 255));
      if (values[k] >= threshold) { want.push_back(k); }
    }
    ft::detail::for_each_above(values, static_cast<std::uint8_t>(threshold),
                               note_place{seen, &count});
    EXPECT_EQ(std::vector<int>(seen, seen + count), want);
  }
}

struct blur_by_strips {
  using scratch = ft::no_scratch;
  template <typename Group>
  FT_HOST_DEVICE void operator()(Group, scratch&, int item, ft::image_pyramid_view const& from,
                                 ft::image_pyramid_view const& to) const {
    auto const in = from.level(0, 0);
    int const columns = ft::ceil_div(in.width, 4);
    int const x = 4 * (item % columns);
    int const y = item / columns * ft::detail::blur_tile::strip_rows;
    if (x < 4 || x + 8 > in.width || y < 3 ||
        y + ft::detail::blur_tile::strip_rows + 3 > in.height || item % 2 == 0) {
      ft::detail::blur_tile::blur_strip<true>(in, to.level(0, 0), x, y);
    } else {
      ft::detail::blur_tile::blur_strip<false>(in, to.level(0, 0), x, y);
    }
  }
};

TYPED_TEST(packed_pixels_unit, blur_by_strips_is_the_blur_by_rows) {
  ft::host_exec const host(1);
  std::vector<std::pair<int, int>> sizes;
  for (int w = ft::detail::blur_tile::least_width; w <= 26; ++w) {
    sizes.emplace_back(w, 4 + w % 20);
  }
  for (int h = ft::detail::blur_tile::least_height; h <= 40; ++h) {
    sizes.emplace_back(8 + h * 7 % 70, h);
  }
  for (auto const& [w, h] : sizes) {
    auto const g = ft::pyramid_geometry::make(w, h, 1, 1.2f);
    image const pixels = noise(at(g.bytes), static_cast<unsigned>(100 * w + h));
    ft::image_pyramid<ft::memory_space::host> const host_from(g);
    ft::image_pyramid<ft::memory_space::host> const host_to(g);
    std::copy(pixels.begin(), pixels.end(), host_from.view().data);
    ft::blur_pyramid(host, host_from.view(), host_to.view(), ft::blur_layout::make(g));

    ft::image_pyramid<TypeParam::exec_type::space> const from(g);
    ft::image_pyramid<TypeParam::exec_type::space> const to(g);
    auto const& exec = this->backend.exec;
    ft::copy(exec, from.view().data, pixels.data(), pixels.size());
    ft::fill_bytes(exec, to.view().data, 0x3c, pixels.size());
    ft::for_each_item<ft::per_thread>(
        exec, ft::ceil_div(w, 4) * ft::ceil_div(h, ft::detail::blur_tile::strip_rows),
        blur_by_strips{}, from.view(), to.view());
    auto const got =
        test::from_exec(exec, static_cast<std::uint8_t const*>(to.view().data), pixels.size());
    for (int y = 0; y < h; ++y) {
      for (int x = 0; x < g.stride[0]; ++x) {
        int const i = y * g.stride[0] + x;
        int const want = x < w ? int{host_to.view().data[i]} : 0x3c;  // padding is left alone
        ASSERT_EQ(int{got[at(i)]}, want) << w << "x" << h << " at " << x << ", " << y;
      }
    }
  }
}

}  // namespace packed_pixels_test

// SPDX-License-Identifier: Apache-2.0
/// @file Stages: place of each kept corner in the output, and its orientation and descriptor.
/// Source: specification section 4.
#pragma once

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>

#include "ft/containers/frame_arrivals.hpp"
#include "ft/containers/image_pyramid.hpp"
#include "ft/containers/keypoints.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/detail/orb_pattern.hpp"
#include "ft/kernels/detail/packed_pixels.hpp"
#include "ft/kernels/distribution.hpp"
#include "ft/kernels/orientation.hpp"

namespace ft {
inline namespace FT_ABI {

/// Pixel columns seen by both cameras of a fisheye pair; keypoints inside go to the end of the
/// list. The default meets no keypoint.
struct stereo_overlap {
  float left = 0;
  float right = 0;

  /// No keypoint, or every keypoint, of images this wide is inside: all are above 0 and below it.
  FT_HOST_DEVICE bool has_none(int width) const {
    return right <= 0 || left >= static_cast<float>(width);
  }
  FT_HOST_DEVICE bool has_all(int width) const {
    return left <= 0 && right >= static_cast<float>(width);
  }
};

/// Points of a descriptor's pattern lie so far from the keypoint at most, rotated and rounded.
inline constexpr int pattern_radius = 18;

namespace detail {

/// Bit of a descriptor's test, rotated. @param at the pixel at an offset from the keypoint
template <typename Pixel>
FT_HOST_DEVICE bool is_darker(pattern_pair p, rotation turn, Pixel const& at) {
  strict_float const ca = turn.cosine;
  strict_float const sb = turn.sine;
  auto const sample = [&](int px, int py) {
    strict_float const fx = static_cast<float>(px);
    strict_float const fy = static_cast<float>(py);
    int const dx = round_to_even((fx * ca - fy * sb).value);
    int const dy = round_to_even((fx * sb + fy * ca).value);
    return at(dx, dy);
  };
  return sample(p.x0, p.y0) < sample(p.x1, p.y1);
}

/// Keeps the products in an array apart from the sums that follow, as keep_apart() does.
template <int N>
FT_HOST_DEVICE FT_INLINE void keep_all_apart(float (&values)[N]) {
#if !defined(__CUDA_ARCH__) && ((defined(__FMA__) && defined(__x86_64__)) || defined(__aarch64__))
  asm("" : "+m"(values));
#else
  static_cast<void>(values);
#endif
}

/// Word `index` of the steered BRIEF descriptor at `centre`, by a single thread: the 64 points of
/// its tests are turned in loops that become vectors. @param stride of the level, below 2^15
FT_HOST_DEVICE FT_INLINE std::uint32_t descriptor_word(std::uint8_t const* centre, int stride,
                                                       rotation turn, pattern_pair const* pattern,
                                                       int index) {
  float const a = turn.cosine;
  float const b = turn.sine;
  constexpr int points = 64;
  static_assert(sizeof(pattern_pair) == 4, "nothing but the points");
  auto const* const tests = reinterpret_cast<std::int8_t const*>(pattern + 32 * index);
  float xa[points], xb[points], ya[points], yb[points];
  for (int i = 0; i < points; ++i) {
    auto const x = static_cast<float>(tests[2 * i]);
    auto const y = static_cast<float>(tests[2 * i + 1]);
    xa[i] = x * a;
    xb[i] = x * b;
    ya[i] = y * a;
    yb[i] = y * b;
  }
  keep_all_apart(xa);
  keep_all_apart(xb);
  keep_all_apart(ya);
  keep_all_apart(yb);
  // Adding this leaves no bits below 1: the nearest integer, halves to even, as round_to_even().
  constexpr float whole = 12582912.0f;
  auto const pitch = static_cast<float>(stride);
  std::int32_t at[points];
  for (int i = 0; i < points; ++i) {
    float const dx = (xa[i] - yb[i] + whole) - whole;
    float const dy = (xb[i] + ya[i] + whole) - whole;
    at[i] = static_cast<std::int32_t>(dy * pitch + dx);  // whole numbers below 2^24
  }
  std::uint32_t word = 0;
  for (int k = 31; k >= 0; --k) {
    word += word + static_cast<std::uint32_t>(centre[at[2 * k]] < centre[at[2 * k + 1]]);
  }
  return word;
}

/// The tests of a descriptor that a thread does where several work together: of each word one,
/// where they are 32, so that neighbouring bits are of neighbouring threads; else bytes.
template <typename Group>
struct own_tests {
  pattern_pair const* all;
  FT_HOST_DEVICE own_tests(Group, pattern_pair const* pattern) : all(pattern) {}
};
#if defined(__CUDACC__)
template <>
struct own_tests<warp_group> {
  static constexpr int words = 8;
  pattern_pair of_word[words];
  __device__ own_tests(warp_group g, pattern_pair const* pattern) {
    FT_UNROLL
    for (int k = 0; k < words; ++k) { of_word[k] = pattern[32 * k + g.rank()]; }
  }
};
#endif

/// Steered BRIEF descriptor by several threads. @param at(dx, dy) a pixel beside the keypoint
template <typename Group, typename Sample>
FT_HOST_DEVICE void describe_together(Group g, Sample const& at, rotation turn,
                                      own_tests<Group> const& tests, descriptor& orb) {
  if constexpr (Group::max_threads == 32) {
#if defined(__CUDA_ARCH__)
    constexpr int words = own_tests<Group>::words;
    std::uint32_t mine = 0;  // thread k keeps word k
    FT_UNROLL
    for (int k = 0; k < words; ++k) {
      std::uint32_t const word = g.ballot(is_darker(tests.of_word[k], turn, at));
      mine = g.rank() == k ? word : mine;
    }
    if (g.rank() < words) { orb.words[g.rank()] = mine; }
#endif
  } else {
    auto* const bytes = reinterpret_cast<unsigned char*>(&orb);
    for (int i = g.rank(); i < 32; i += g.size()) {
      unsigned byte = 0;
      for (int bit = 0; bit < 8; ++bit) {
        byte |= static_cast<unsigned>(is_darker(tests.all[8 * i + bit], turn, at)) << bit;
      }
      bytes[i] = static_cast<unsigned char>(byte);
    }
  }
}

}  // namespace detail

/// One image: nothing is done with its keypoints once they have their places.
struct only_order {
  using scratch = no_scratch;

  /// Before the launches ahead have ended; ends with a sync().
  template <typename Group>
  FT_HOST_DEVICE void prepare(Group, scratch&, int, keypoints_view const&) const {}
  /// For each keypoint before it has its place, @returns what keep() gets once it has.
  template <typename Group>
  FT_HOST_DEVICE std::uint32_t count(Group, scratch&, int, keypoints_view const&, float,
                                     float) const {
    return 0;
  }
  FT_HOST_DEVICE void keep(scratch&, int, std::uint32_t) const {}
  /// After a sync().
  template <typename Group>
  FT_HOST_DEVICE void sort(Group, scratch&, int, keypoints_view const&, int) const {}
};

/// One image: where each kept corner goes, and what is known of its keypoint. Level by level in
/// list order; inside the overlap from the end of the array backwards.
/// @tparam Then what the same group does with the keypoints on the way, and at last; see only_order
template <typename Then = only_order>
struct order_image {
  Then then;
  std::size_t extra = 0;              ///< block scratch that nobody uses
  static constexpr int known = 2048;  ///< slots whose levels are found out ahead
  struct scratch {
    typename Then::scratch then;
    int before[max_levels + 1];  ///< corners of the levels below each
    std::uint8_t level[known];   ///< of a slot; each is read by the thread that wrote it
  };
  /// More would be of no use, and cost registers.
  static constexpr int side_by_side = 1;

  std::size_t extra_bytes() const { return extra; }

  static constexpr bool prepares = true;
  template <typename Group>
  FT_HOST_DEVICE void prepare(Group g, scratch& s, int image, pyramid_geometry const&,
                              distribution_view const& kept, stereo_overlap const*, int*,
                              keypoints_view const& out, int*, frame_arrivals const&) const {
    FT_NO_UNROLL
    for (int i = g.rank(); i < known; i += g.size()) {
      s.level[i] = static_cast<std::uint8_t>(kept.layout.level_of(i));
    }
    then.prepare(g, s.then, image, out);
  }

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int image, pyramid_geometry const& geometry,
                                 distribution_view const& kept, stereo_overlap const* overlaps,
                                 int* place, keypoints_view const& out, int* mono_count,
                                 frame_arrivals const& arrivals) const {
    constexpr int together = 2;  // slots of a thread, of which loads are under way at a time
    distribution_layout const& layout = kept.layout;
    int const* const counts = kept.kept_count + image * layout.levels;
    stereo_overlap const overlap = overlaps[image];
    // Corners are under way while it is found out how many there are.
    slot_place of[together];
    auto const fetch = [&](int base) {
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        int const slot = base + k * g.size() + g.rank();
        of[k] = slot_place(slot);
        // Past the last slot that one again: no load is behind a branch. There is always one.
        int const held = max_of(min_of(slot, layout.total - 1), 0);
        of[k].word = corner_word(kept.kept + image * layout.total + held);
        bool const ahead = Group::max_threads > 1 && slot < known;
        of[k].level = ahead ? static_cast<int>(s.level[slot]) : layout.level_of(slot);
      }
    };
    fetch(0);
    for (int l = g.rank(); l <= max_levels; l += g.size()) {
      int sum = 0;
      FT_UNROLL
      for (int k = 0; k < max_levels; ++k) { sum += k < min_of(l, layout.levels) ? counts[k] : 0; }
      s.before[l] = sum;
    }
    g.sync();
    int const all = s.before[layout.levels];
    int stereo = 0;  // corners in lower slots inside the overlap
    for (int base = 0; base < layout.total; base += together * g.size()) {
      std::uint32_t entry[together] = {};
      unsigned inside = 0;  // 16 bits each
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        of[k].locate(layout, s.before, geometry, overlap);
        inside |= static_cast<unsigned>(of[k].inside) << (16 * k);
        if (of[k].valid) { entry[k] = then.count(g, s.then, image, out, of[k].x, of[k].y); }
      }
      int total = 0;
      int const lower = g.exclusive_scan(static_cast<int>(inside), total);
      FT_UNROLL
      for (int k = 0; k < together; ++k) {
        int const stereo_rank = stereo + (lower >> (16 * k) & 0xffff);
        stereo += total >> (16 * k) & 0xffff;
        if (!of[k].valid) { continue; }
        int const at = of[k].inside ? all - 1 - stereo_rank : of[k].rank - stereo_rank;
        place[image * layout.total + of[k].slot] = at;
        int const to = image * out.capacity + at;
        get<field::x>(out, to) = of[k].x;
        get<field::y>(out, to) = of[k].y;
        get<field::response>(out, to) = static_cast<float>(of[k].c.response);
        get<field::octave>(out, to) = of[k].level;
        then.keep(s.then, at, entry[k]);
      }
      if (base + together * g.size() < layout.total) { fetch(base + together * g.size()); }
    }
    if (g.rank() == 0) {
      out.count[image] = all;
      mono_count[image] = all - stereo;
    }
    // The others work out their places themselves: those who tell have to wait for their stores.
    int const width = geometry.width[0];
    if (!overlap.has_none(width) && !overlap.has_all(width)) { arrivals.tell_placed(g, image); }
    then.sort(g, s.then, image, out, all);
  }

private:
  FT_HOST_DEVICE static std::uint64_t corner_word(corner const* at) {
    static_assert(sizeof(corner) == 8 && alignof(corner) == 8, "a corner is a word");
#if defined(__CUDA_ARCH__)
    return *reinterpret_cast<unsigned long long const*>(at);
#else
    std::uint64_t word;
    std::memcpy(&word, at, sizeof word);
    return word;
#endif
  }

  /// The kept corner of a slot.
  struct slot_place {
    int slot;
    int level = 0;
    int rank = 0;  ///< among all of the image
    bool valid = false;
    bool inside = false;  ///< the overlap
    /// The corner as it was loaded: to look at its parts is to wait for it.
    std::uint64_t word = 0;
    corner c{};
    float x = 0;
    float y = 0;

    slot_place() = default;
    FT_HOST_DEVICE explicit slot_place(int at) : slot(at) {}
    FT_HOST_DEVICE void locate(distribution_layout const& layout, int const* before,
                               pyramid_geometry const& geometry, stereo_overlap const& overlap) {
      std::memcpy(&c, &word, sizeof c);
      rank = before[level] + slot - layout.first[level];
      valid = slot < layout.total && rank < before[level + 1];
      x = static_cast<float>(c.x + corner_border);
      y = static_cast<float>(c.y + corner_border);
      if (level > 0) {
        x = detail::mul(x, geometry.scale[level]);
        y = detail::mul(y, geometry.scale[level]);
      }
      inside = valid && x >= overlap.left && x <= overlap.right;
    }
  };
};

/// One kept corner: the angle and descriptor of its keypoint.
struct describe_corner {
  /// [batch] as order_image has them; needed where this is done beside that
  stereo_overlap const* overlaps = nullptr;
  static constexpr bool wide_on_host = true;
  static constexpr int window = 2 * pattern_radius + 1;
  static constexpr int window_words = (window + 3 + 3) / 4;
  struct scratch {  ///< where threads work together: the window around the keypoint
    std::uint32_t pixels[window * window_words];
  };

  template <typename Group>
  FT_HOST_DEVICE void operator()(Group g, scratch& s, int item, image_pyramid_view const& pyramid,
                                 image_pyramid_view const& blurred, distribution_view const& kept,
                                 pattern_pair const* pattern, int const* place,
                                 keypoints_view const& out, frame_arrivals const& arrivals) const {
    distribution_layout const& layout = kept.layout;
    int const image = item / layout.total;
    int const slot = item % layout.total;
    // All loads are under way together: a slot without a corner holds something, too.
    corner const c = kept.kept[item];
    int const* const counts = kept.kept_count + image * layout.levels;
    [[maybe_unused]] level_count const own(g, counts, layout.levels);
    [[maybe_unused]] stereo_overlap const overlap =
        Group::max_threads > 1 && overlaps != nullptr ? overlaps[image] : unknown_overlap();
    int const l = level_of(layout, slot);
    int const count = Group::max_threads > 1 ? g.shuffle(own.count, l) : counts[l];
    g.sync();
    if (slot - layout.first[l] >= count) { return; }

    int const x = c.x + corner_border;
    int const y = c.y + corner_border;
    gray_view const sharp = pyramid.level(image, l);
    gray_view const level = blurred.level(image, l);
    int to = image * out.capacity;
    float angle = 0;
    if constexpr (Group::max_threads > 1) {
      detail::own_tests<Group> const tests(g, pattern);
      angle = stage_and_turn(g, sharp, level, x, y, s.pixels);
      g.sync();
      rotation const turn = rotation_by(angle);
      int const width = pyramid.geometry.width[0];
      bool const none = overlap.has_none(width);
      if (none || overlap.has_all(width)) {
        int const rank = own.below(g, l) + slot - layout.first[l];
        to += none ? rank : own.all(g) - 1 - rank;
      } else {
        arrivals.await_placed(g, image);
        to += place[item];
      }
      auto const* const centre = reinterpret_cast<std::uint8_t const*>(s.pixels) +
                                 pattern_radius * (4 * window_words + 1) +
                                 ((x - pattern_radius) & 3);
      auto const at = [&](int dx, int dy) { return centre[dy * 4 * window_words + dx]; };
      detail::describe_together(g, at, turn, tests, get<field::orb>(out, to));
    } else {
      fetch_window(level, x, y);
      angle = orientation(g, sharp, x, y);
      rotation const turn = rotation_by(angle);
      to += place[item];
      descriptor& orb = get<field::orb>(out, to);
      for (int i = 0; i < 8; ++i) {
        orb.words[i] = detail::descriptor_word(level.row(y) + x, level.stride, turn, pattern, i);
      }
    }
    if (g.rank() == 0) { get<field::angle>(out, to) = angle; }
  }

private:
  /// The kept corners of an image's levels, of which each thread has one.
  struct level_count {
    int level, count;

    template <typename Group>
    FT_HOST_DEVICE level_count(Group g, int const* counts, int levels) : level(g.rank()), count(0) {
      static_assert(Group::max_threads == 1 || Group::max_threads >= max_levels, "one a thread");
      if (Group::max_threads > 1 && level < levels) { count = counts[level]; }
    }
    template <typename Group>
    FT_HOST_DEVICE int below(Group g, int l) const {
      return g.reduce(level < l ? count : 0, sum_op{});
    }
    template <typename Group>
    FT_HOST_DEVICE int all(Group g) const {
      return g.reduce(count, sum_op{});
    }
  };

  /// In which some keypoints are and some are not.
  FT_HOST_DEVICE static stereo_overlap unknown_overlap() { return {1e-30f, 1e-30f}; }
  /// As layout.level_of(): no comparison waits for the one before.
  FT_HOST_DEVICE static int level_of(distribution_layout const& layout, int slot) {
    int l = 0;
    FT_UNROLL
    for (int k = 1; k < max_levels; ++k) {
      l += static_cast<int>((k < layout.levels) & (slot >= layout.first[k]));
    }
    return l;
  }
  /// Copies the window into scratch and returns the angle; the pixels of both are fetched together.
  template <typename Group>
  FT_HOST_DEVICE static float stage_and_turn(Group g, gray_view sharp, gray_view level, int x,
                                             int y, std::uint32_t* pixels) {
    bool const words = Group::max_threads >= 32 && detail::has_word_rows(sharp);
    detail::disc_words<Group> disc;
    if (words) { disc = detail::disc_words<Group>(g, sharp, x, y); }
    detail::stage_rectangle<12>(g, level, x - pattern_radius, y - pattern_radius, window, window,
                                pixels, window_words);
    if (!words) { return orientation(g, sharp, x, y); }
    detail::moments const m = disc.sums(g);
    return fast_atan2_degrees(static_cast<float>(m.m01), static_cast<float>(m.m10));
  }
  /// Has a window that is needed soon brought into the caches, on the host.
  FT_HOST_DEVICE static void fetch_window(gray_view level, int x, int y) {
#if defined(__GNUC__) && !defined(__CUDA_ARCH__)
    for (int r = -pattern_radius; r <= pattern_radius; ++r) {
      std::uint8_t const* const row = level.row(y + r) + x;
      __builtin_prefetch(row - pattern_radius);
      __builtin_prefetch(row + pattern_radius);
    }
#else
    static_cast<void>(level);
    static_cast<void>(x);
    static_cast<void>(y);
#endif
  }
};

/// Keypoints of a batch of images from their kept corners, in the contract's order; all but their
/// angles and descriptors. Asynchronous on `exec`; allocates nothing; one launch.
/// @param overlaps [batch] @param mono_count [batch] gets the keypoints outside the overlap
/// @param place [batch][layout.total] gets the place of a kept corner's keypoint; all in executor
/// memory
/// @param arrivals tells describe_corners() beside this launch which images have their places, of
/// those that have keypoints inside their overlap and outside
/// @param then see order_image
template <typename Exec, typename Then = only_order>
void order_corners(Exec const& exec, pyramid_geometry const& geometry,
                   distribution_view const& kept, stereo_overlap const* overlaps,
                   keypoints_view const& out, int* mono_count, int* place,
                   frame_arrivals const& arrivals = {}, Then const& then = {}) {
  constexpr int threads = 1024;
  // All the block scratch that there is: then nothing else is on its multiprocessor.
  std::size_t const extra = extra_scratch<threads, order_image<Then>>(exec, out.batch);
  for_each_item<per_block<threads>>(exec, out.batch, order_image<Then>{then, extra}, geometry, kept,
                                    overlaps, place, out, mono_count, arrivals);
}

/// Angles and descriptors of ordered keypoints. Asynchronous on `exec`; allocates nothing; one
/// launch.
/// @param pattern [256], points within `pattern_radius` @param place from order_corners
/// @param arrivals where this launch is beside order_corners(): the same
/// @param overlaps likewise; without them the places are read
/// @throws bad_argument for arrivals without overlaps
template <typename Exec>
void describe_corners(Exec const& exec, image_pyramid_view const& pyramid,
                      image_pyramid_view const& blurred, distribution_view const& kept,
                      pattern_pair const* pattern, int const* place, keypoints_view const& out,
                      frame_arrivals const& arrivals = {},
                      stereo_overlap const* overlaps = nullptr) {
  detail::require(!arrivals.overlapping() || overlaps != nullptr,
                  "descriptors beside the order need its overlaps");
  for_each_item<per_warp>(exec, pyramid.batch * kept.layout.total, describe_corner{overlaps},
                          pyramid, blurred, kept, pattern, place, out, arrivals);
}

}  // namespace FT_ABI
}  // namespace ft

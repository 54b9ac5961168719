// SPDX-License-Identifier: Apache-2.0
// A lost camera that sees another scene of the same kind is not found in its map; one that sees its
// own is.
#if !defined(__CUDACC__)  // the host alone: odometry_test compares the executors
#include <gtest/gtest.h>

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <sstream>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/stereo_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/random.hpp"

namespace wrong_place_test {

using test::at;
using image = std::vector<std::uint8_t>;

constexpr int width = 480;
constexpr int height = 360;
constexpr int wide = 1200;
constexpr int high = 720;
constexpr std::int64_t period = 100'000'000;

enum class kind { blocks, binary, windows, bricks, dots };

/// Fills [x0, x1) x [y0, y1), as far as it is in the image.
void fill(image& in, int x0, int y0, int x1, int y1, int grey) {
  for (int y = std::max(y0, 0); y < std::min(y1, high); ++y) {
    for (int x = std::max(x0, 0); x < std::min(x1, wide); ++x) {
      in[at(y) * at(wide) + at(x)] = static_cast<std::uint8_t>(grey);
    }
  }
}

/// A wall of a kind. Those of repeated things differ by a few pixels and grey levels.
image wall(kind of, unsigned seed) {
  test::generator random(seed);
  image all(at(wide) * at(high), 90);
  auto const each = [&](int width_of, int height_of, auto const& put) {
    for (int y = 0; y < high; y += height_of) {
      for (int x = 0; x < wide; x += width_of) { put(x, y); }
    }
  };
  switch (of) {
    case kind::blocks:
      each(6, 6, [&](int x, int y) { fill(all, x, y, x + 6, y + 6, random.below(256)); });
      break;
    case kind::binary:
      each(6, 6, [&](int x, int y) { fill(all, x, y, x + 6, y + 6, 60 + 120 * random.below(2)); });
      break;
    case kind::windows:
      each(48, 40, [&](int x, int y) {
        int const left = x + 10 + random.below(3), top = y + 8 + random.below(3);
        fill(all, left, top, x + 38, y + 32, 200 + random.below(40));
      });
      break;
    case kind::bricks:
      each(44, 20, [&](int x, int y) {
        int const left = x + y / 20 % 2 * 22;
        fill(all, left + 2, y + 2, left + 41 + random.below(2), y + 19, 130 + random.below(60));
      });
      break;
    case kind::dots:
      for (int i = 0; i < 9000; ++i) {
        int const x = random.below(wide - 5), y = random.below(high - 5);
        fill(all, x, y, x + 5, y + 5, 200 * random.below(2));
      }
  }
  return all;
}

struct stereo_pair {
  image left, right;
};

/// The wall in the upper half, and twice as near in the lower one, from a camera that went
/// `shift` pixels to the right; with noise.
stereo_pair see(image const& of, int shift, unsigned noise) {
  test::generator random(noise);
  stereo_pair p{image(at(width) * at(height)), image(at(width) * at(height))};
  for (int y = 0; y < height; ++y) {
    int const near = y < height / 2 ? 1 : 2;
    for (int x = 0; x < width; ++x) {
      std::size_t const from = at(100 + y) * at(wide) + at(150 + near * shift + x);
      std::size_t const to = at(y) * at(width) + at(x);
      auto const noisy = [&](int grey) {
        return static_cast<std::uint8_t>(std::clamp(grey + random.below(9) - 4, 0, 255));
      };
      p.left[to] = noisy(of[from]);
      p.right[to] = noisy(of[from + at(12 * near)]);
    }
  }
  return p;
}

/// One pixel of the upper half, metres: its depth is 3.3 m.
constexpr double metres = 0.11 / 12;

class camera {
public:
  camera()
      : odo_(ft::host_exec(1), ft::rectified_rig::make({360, 360, 240, 180}, 0.11), params()) {}

  /// A map of the wall. The poses are told: a repeated wall is hard to follow, too.
  std::string map_of(image const& of) {
    for (int i = 0; i < 15; ++i) {
      auto T = ft::rigid<double>::identity();
      T.t.x = 3 * i * metres;
      odo_.predict(T);
      track(see(of, 3 * i, static_cast<unsigned>(i)));
    }
    EXPECT_NEAR(last_.T_world_camera.t.x, 42 * metres, 0.01);
    std::ostringstream to;
    odo_.save_map(to);
    return to.str();
  }
  struct answer {
    bool found;
    double x;
  };
  /// Whether and where a camera is found in a map in the frames before a new map begins.
  answer look(std::string const& map, image const& at, int shift, unsigned noise) {
    std::istringstream from(map);
    odo_.load_map(from);
    time_ = 0;
    for (unsigned i = 0; i < 5; ++i) {
      track(see(at, shift, 100 * noise + i));
      if (last_.maps > 1) { break; }
      if (last_.state == ft::tracking_state::tracking) { return {true, last_.T_world_camera.t.x}; }
    }
    return {false, 0};
  }

private:
  static ft::odometry_params params() {
    ft::odometry_params p;
    p.orb.width = width;
    p.orb.height = height;
    p.orb.features = 1000;
    return p;
  }
  void track(stereo_pair const& p) {
    last_ =
        odo_.track({{p.left.data(), width, height, width}, {p.right.data(), width, height, width}},
                   time_ += period);
  }
  ft::odometry<ft::host_exec> odo_;
  ft::tracking last_;
  std::int64_t time_ = 0;
};

class WrongPlace : public testing::TestWithParam<kind> {};

TEST_P(WrongPlace, IsNotTakenForTheMapsOwn) {
  camera c;
  auto const own = wall(GetParam(), 3);
  std::string const map = c.map_of(own);
  int wrong = 0;
  unsigned const others = static_cast<unsigned>(std::max(2, test::effort(5)));
  for (unsigned other = 1; other <= others; ++other) {
    wrong += static_cast<int>(
        c.look(map, wall(GetParam(), 3 + other), 7 * static_cast<int>(other), other).found);
  }
  EXPECT_EQ(wrong, 0);
  // Where the camera was last.
  auto const right = c.look(map, own, 42, 77);
  EXPECT_TRUE(right.found);
  EXPECT_NEAR(right.x, 42 * metres, 0.01);
}

std::string name_of(testing::TestParamInfo<kind> const& of) {
  char const* const names[] = {"blocks", "binary", "windows", "bricks", "dots"};
  return names[static_cast<int>(of.param)];
}
INSTANTIATE_TEST_SUITE_P(Kinds, WrongPlace,
                         testing::Values(kind::blocks, kind::binary, kind::windows, kind::bricks,
                                         kind::dots),
                         name_of);

}  // namespace wrong_place_test
#endif

// SPDX-License-Identifier: Apache-2.0
// Which cells of an image stay as they are while the rest moves.
#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/kernels/odometry/image_changes.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/plain_map.hpp"
#include "tests/support/random.hpp"

namespace watch_images_test {

using test::at;
using changes = ft::image_changes;

struct arrays {
  ft::image_pyramid_view images;
  ft::image_changes_view changes;
  unsigned* missing = nullptr;
};

/// Two images of a rig.
template <typename Exec>
struct camera {
  Exec const& exec;
  int width, height;
  test::mirrored<Exec, arrays> data;

  camera(Exec const& on, int w, int h)
      : exec(on), width(w), height(h), data([&](ft::carver& c, arrays& v) {
          carve(c, v.images, ft::pyramid_geometry::make(w, h, 1, 1.2f), 2);
          carve(c, v.changes, 2);
          v.missing = c.take<unsigned>(1);
          v.changes.missing = v.missing;
          v.changes.images_of_rig = 2;
        }) {
    *data.host.missing = 0;
    for (int i = 0; i < 2; ++i) { data.host.changes.begun[i] = 0; }
  }
  /// @param grey of image i at a pixel
  template <typename Grey>
  void see(Grey const& grey) {
    for (int i = 0; i < 2; ++i) {
      auto const to = data.host.images.level(i, 0);
      for (int y = 0; y < height; ++y) {
        for (int x = 0; x < width; ++x) { to.row(y)[x] = static_cast<std::uint8_t>(grey(i, x, y)); }
      }
    }
    data.push(exec);
    ft::watch_images(exec, data.device.images, data.device.changes);
    data.pull(exec);
  }
  changes const& of(int i) const { return data.host.changes.of[i]; }
  bool fixed(int i, float x, float y, bool sure = false) const {
    return data.host.changes.is_fixed(i, x, y, width, height, sure);
  }
};

int texture(int x, int y) {
  unsigned h = static_cast<unsigned>(x) * 73856093U ^ static_cast<unsigned>(y) * 19349663U;
  h ^= h >> 13;
  h *= 0x5bd1e995U;
  return static_cast<int>((h >> 15) % 200U) + 20;
}

/// Mean over a run of so many pixels along the rows and the columns.
int smeared(int x, int y, int along_x, int along_y) {
  int sum = 0;
  for (int i = 0; i < along_x * along_y; ++i) { sum += texture(x + i / along_y, y + i % along_y); }
  return sum / (along_x * along_y);
}

template <typename Backend>
class WatchImages : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(WatchImages, test::backends);

TYPED_TEST(WatchImages, GoOnWhereAnImageWasMissing) {
  TypeParam backend;
  camera<typename TypeParam::exec_type> gaps(backend.exec, 320, 240);
  camera<typename TypeParam::exec_type> whole(backend.exec, 320, 240);
  // Image 0 misses every second frame, and is black there. The other camera has only its frames.
  for (int frame = 0; frame < 20; ++frame) {
    bool const missing = frame % 2 == 1;
    auto const grey = [&](int, int x, int y) { return texture(y >= 160 ? x : x + 31 * frame, y); };
    *gaps.data.host.missing = missing ? 1u : 0u;
    gaps.see([&](int i, int x, int y) { return missing && i == 0 ? 0 : grey(i, x, y); });
    if (!missing) { whole.see(grey); }
    SCOPED_TRACE(frame);
    changes const& of = gaps.of(0);
    EXPECT_EQ(of.fixed, whole.of(0).fixed);
    EXPECT_EQ(of.by_quarters, whole.of(0).by_quarters);
    for (int k = 0; k < 300; k += 7) {
      auto const x = static_cast<float>(k), y = static_cast<float>(k % 240);
      EXPECT_EQ(gaps.fixed(0, x, y), whole.fixed(0, x, y)) << k;
      EXPECT_EQ(gaps.fixed(0, x, y, true), whole.fixed(0, x, y, true)) << k;
    }
    EXPECT_EQ(of.textured, missing ? 0 : whole.of(0).textured);
    EXPECT_EQ(of.moved, missing ? 0 : whole.of(0).moved);
    EXPECT_EQ(of.sum, missing ? 0 : whole.of(0).sum);
    EXPECT_GT(gaps.of(1).sum, 0);
  }
  EXPECT_EQ(gaps.of(0).fixed, changes::cells / 3);
}

TYPED_TEST(WatchImages, FindWhatIsFixedWhileTheRestMoves) {
  TypeParam backend;
  camera<typename TypeParam::exec_type> c(backend.exec, 320, 240);
  // The lower half of the first image stays, with another light in each frame. So does a quarter.
  for (int frame = 0; frame < 10; ++frame) {
    c.see([&](int i, int x, int y) {
      bool const stays = i == 0 && y >= 160;
      return texture(stays ? x : x + 31 * frame, y) + (stays ? frame : 0);
    });
    SCOPED_TRACE(frame);
    EXPECT_EQ(c.of(0).same, 0);
    EXPECT_EQ(c.of(0).still, frame == 0 ? 0 : changes::cells / 3);
    EXPECT_EQ(c.of(0).moved, frame == 0 ? 0 : changes::cells * 2 / 3);
    EXPECT_EQ(c.of(0).fixed, frame == 0 ? 0 : changes::cells / 3);
    EXPECT_EQ(c.fixed(0, 100, 200), frame > 0);
    EXPECT_EQ(c.fixed(0, 100, 200, true), frame >= 8);
    EXPECT_FALSE(c.fixed(0, 100, 120));
    EXPECT_FALSE(c.fixed(1, 100, 200));
  }
  // A camera at rest forgets nothing.
  auto const last = [&](int i, int x, int y) {
    return texture(i == 0 && y >= 160 ? x : x + 279, y) + (i == 0 && y >= 160 ? 9 : 0);
  };
  c.see(last);
  EXPECT_EQ(c.of(0).same, 1);
  EXPECT_TRUE(c.fixed(0, 100, 200, true));
  // What moves is no longer fixed.
  c.see([&](int i, int x, int y) { return last(i, x + 17, y); });
  EXPECT_FALSE(c.fixed(0, 100, 200));
}

/// Patches of 40 pixels with gaps of 24, which cells of 10 x 10 pixels do not fit.
bool in_patch(int x, int y) { return (x + 61) % 64 < 40 && (y + 53) % 64 < 40; }

/// Whether the four samples of a quarter of a cell are in patches, of 320 x 240 pixels.
bool quarter_in_patch(int column, int row) {
  bool all = true;
  for (int k = 0; k < 4; ++k) {
    int const x = 2 * column + k % 2, y = 2 * row + k / 2;
    all = all && in_patch((2 * x + 1) * 320 / 256, (2 * y + 1) * 240 / 192);
  }
  return all;
}

TYPED_TEST(WatchImages, QuartersOfCellsFindPatchesThatCellsDoNotFit) {
  TypeParam backend;
  camera<typename TypeParam::exec_type> c(backend.exec, 320, 240);
  auto const see = [&](int frame) {
    c.see([&](int i, int x, int y) {
      return texture(i == 0 && in_patch(x, y) ? x : x + 31 * frame, y);
    });
  };
  auto const is_next_to_patch = [](int x, int y) {  // quarters have 5 x 5 pixels
    bool any = false;
    for (int k = 0; k < 4; ++k) {
      int const dx = k % 2 == 0 ? -3 : 2, dy = k / 2 == 0 ? -3 : 2;
      if (x + dx < 0 || x + dx >= 320 || y + dy < 0 || y + dy >= 240) { continue; }
      any = any || quarter_in_patch((x + dx) / 5, (y + dy) / 5);
    }
    return any;
  };
  for (int frame = 0; frame < 10; ++frame) {
    see(frame);
    SCOPED_TRACE(frame);
    EXPECT_EQ(c.of(0).by_quarters, frame >= 4 ? 1 : 0);
    EXPECT_EQ(c.of(1).by_quarters, 0);
    EXPECT_EQ(c.of(0).rest_moves, frame >= 1 ? 1 : 0);
  }
  int fixed = 0, by_cells = 0;
  for (int y = 0; y < 240; ++y) {
    for (int x = 0; x < 320; ++x) {
      auto const px = static_cast<float>(x), py = static_cast<float>(y);
      ASSERT_EQ(c.fixed(0, px, py, true), is_next_to_patch(x, y)) << x << ' ' << y;
      ASSERT_FALSE(c.fixed(1, px, py));
      if (in_patch(x - 2, y - 2) && in_patch(x + 2, y + 2)) {
        ASSERT_TRUE(c.fixed(0, px, py)) << x << ' ' << y;
      }
      fixed += static_cast<int>(c.fixed(0, px, py));
      unsigned const bits = c.of(0).now[y / 10];
      by_cells += static_cast<int>(bits >> x / 10 & 1u);
    }
  }
  EXPECT_GT(3 * fixed, 4 * by_cells);
  // A camera at rest fixes nothing else, and forgets nothing.
  for (int k = 0; k < 12; ++k) { see(9); }
  EXPECT_TRUE(c.fixed(0, 20, 20, true));
  EXPECT_FALSE(c.fixed(0, 55, 63));
}

TYPED_TEST(WatchImages, AreComparedWithTheFrameBefore) {
  TypeParam backend;
  camera<typename TypeParam::exec_type> c(backend.exec, 320, 240);
  // Grey values drift by 4 in a frame: what is still today is not what it was two frames ago.
  for (int frame = 0; frame < 8; ++frame) {
    c.see([&](int, int x, int y) {
      return 110 + texture(x, y) / 6 + (texture(x + 900, y + 900) < 120 ? 4 : -4) * frame;
    });
    SCOPED_TRACE(frame);
    EXPECT_EQ(c.of(0).moved, 0);
    EXPECT_GT(c.of(0).textured, frame == 0 ? -1 : changes::cells / 2);
  }
}

TYPED_TEST(WatchImages, StreaksAreToldFromWhatIsSharpOrSoftInBothDirections) {
  TypeParam backend;
  camera<typename TypeParam::exec_type> c(backend.exec, 320, 240);
  struct row {
    int along_x, along_y;
    bool streaked;
  };
  for (row const& r : {row{1, 1, false}, row{3, 1, false}, row{5, 1, true}, row{1, 5, true},
                       row{16, 1, true}, row{6, 6, false}, row{6, 2, true}}) {
    c.see([&](int i, int x, int y) { return i == 0 ? smeared(x, y, r.along_x, r.along_y) : 90; });
    EXPECT_EQ(c.of(0).streaked, r.streaked ? 1 : 0) << r.along_x << " x " << r.along_y;
    EXPECT_EQ(c.of(1).streaked, 0) << "without contrast";
  }
  // Upright bars: along the columns there is noise alone.
  c.see([&](int, int x, int y) { return 60 + 80 * (x / 40 % 2) + texture(x, y) / 40; });
  EXPECT_EQ(c.of(0).streaked, 0);
}

// Of a bar above the image, or beside it. Samples are 5 pixels apart.
TYPED_TEST(WatchImages, AnEdgeFromSideToSideIsNoStreak) {
  TypeParam backend;
  camera<typename TypeParam::exec_type> c(backend.exec, 640, 480);
  for (int at = 200; at < 206; ++at) {
    for (int bar : {0, 16, 255}) {
      c.see([&](int i, int x, int y) { return (i == 0 ? y : x) < at ? bar : smeared(x, y, 4, 4); });
      EXPECT_EQ(c.of(0).streaked, 0) << "below row " << at << " of " << bar;
      EXPECT_EQ(c.of(1).streaked, 0) << "beside column " << at << " of " << bar;
    }
  }
}

TYPED_TEST(WatchImages, NothingIsFixedInAFlatOrAStillImage) {
  TypeParam backend;
  camera<typename TypeParam::exec_type> c(backend.exec, 64, 48);
  for (int frame = 0; frame < 10; ++frame) {
    c.see([&](int i, int x, int y) { return i == 0 ? 50 + frame : texture(x, y); });
    for (int i = 0; i < 2; ++i) {
      for (unsigned const bits : c.of(i).now) { EXPECT_EQ(bits, 0U); }
    }
    EXPECT_EQ(c.of(0).textured, 0);
    EXPECT_EQ(c.of(0).by_quarters + c.of(1).by_quarters, 0);
    EXPECT_EQ(c.of(1).same, frame > 0 ? 1 : 0);
  }
  // Pixels at, and outside of, the border belong to the outermost cells.
  EXPECT_FALSE(c.fixed(1, -5, -5));
  EXPECT_FALSE(c.fixed(1, 1e6f, 1e6f));
}

TYPED_TEST(WatchImages, SumsOfAllSamplesAndNothingOfAnAbsentImage) {
  TypeParam backend;
  camera<typename TypeParam::exec_type> c(backend.exec, 320, 240);
  auto const grey = [](int i, int x, int y) { return texture(x + i, y); };
  int sum = 0, squares = 0;
  for (int y = 0; y < changes::rows * changes::side; ++y) {
    for (int x = 0; x < changes::columns * changes::side; ++x) {
      int const v = texture((2 * x + 1) * 320 / 256, (2 * y + 1) * 240 / 192);
      sum += v;
      squares += v * v;
    }
  }
  c.see(grey);
  EXPECT_EQ(c.of(0).sum, sum);
  EXPECT_EQ(c.of(0).squares, squares);

  c.data.device.images.absent = {2, 2};
  c.see(grey);
  EXPECT_EQ(c.of(0).same, 1);
  changes const& absent = c.of(1);
  EXPECT_EQ(absent.textured + absent.moved + absent.still + absent.same + absent.sum, 0);
  EXPECT_EQ(absent.squares + absent.streaked + absent.fixed, 0);
  for (unsigned const bits : absent.now) { EXPECT_EQ(bits, 0U); }

  c.data.device.images.absent = {};
  c.see(grey);
  EXPECT_EQ(c.of(1).same, 1) << "as the frame before it was absent";
}

}  // namespace watch_images_test

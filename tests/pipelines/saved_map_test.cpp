// SPDX-License-Identifier: Apache-2.0
// Saved maps that somebody changed, and maps of other rigs: refused with words, or harmless.
#if !defined(__CUDACC__)  // the host alone: files are read there, and answers are the same
#include <gtest/gtest.h>

#include <algorithm>
#include <climits>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <sstream>
#include <streambuf>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/random.hpp"
#include "tests/support/refusals.hpp"

namespace saved_map_test {

using test::at;
using test::saved;

constexpr int width = 240;
constexpr int height = 180;
constexpr int texels = 900;

ft::pinhole<float> camera() { return {200.0f, 200.0f, 120.0f, 90.0f}; }
ft::rectified_rig rig() { return ft::rectified_rig::make(camera(), 0.11); }

ft::odometry_params params() {
  ft::odometry_params p;
  p.orb.width = width;
  p.orb.height = height;
  p.orb.features = 300;
  p.orb.levels = 3;
  p.map_slots = 1024;
  p.local_points = 512;
  p.window_points = 512;
  p.keyframes = 6;
  p.window = {3, 2};
  p.rules.keyframe_period_s = 0.15;  // so that a loaded map soon has a new keyframe
  return p;
}

/// Blocks of grey.
std::vector<std::uint8_t> const& wall() {
  static std::vector<std::uint8_t> const grey = [] {
    std::vector<std::uint8_t> all(at(texels) * at(texels));
    test::generator random(5);
    std::vector<std::uint8_t> block(at(texels / 6) * at(texels / 6));
    for (auto& b : block) { b = static_cast<std::uint8_t>(random.below(256)); }
    for (int y = 0; y < texels; ++y) {
      for (int x = 0; x < texels; ++x) {
        all[at(y) * at(texels) + at(x)] = block[at(y / 6) * at(texels / 6) + at(x / 6)];
      }
    }
    return all;
  }();
  return grey;
}

/// The wall from a camera that goes to the right, 2 pixels a frame.
ft::stereo_images frame(int i) {
  std::uint8_t const* const from = wall().data() + at(50) * at(texels) + at(100 + 2 * i);
  return {{from, width, height, texels}, {from + 8, width, height, texels}};
}
constexpr std::int64_t period = 100'000'000;

using odometry = ft::odometry<ft::host_exec>;

ft::tracking walk(odometry& odo, int begin, int end) {
  ft::tracking t;
  for (int i = begin; i < end; ++i) { t = odo.track(frame(i), i * period); }
  return t;
}
constexpr int walked = 12;

odometry made(ft::odometry_params const& p = params()) { return {ft::host_exec(1), rig(), p}; }

std::string const& good() {
  static std::string const file = [] {
    odometry odo = made();
    walk(odo, 0, walked);
    return saved(odo);
  }();
  return file;
}

/// What load_map() says; empty if it takes the file.
template <typename Odometry>
std::string refusal(Odometry& odo, std::string const& file) {
  std::istringstream from(file);
  return test::refusal<ft::error>([&] { odo.load_map(from); });
}

TEST(SavedMap, ASnapshotIsWrittenWhileTrackingGoesOn) {
  ft::map_snapshot snapshot;
  std::string written;
  {
    odometry odo = made(), other = made();
    walk(odo, 0, walked);
    snapshot = odo.snapshot_map();
    std::thread writes([&] {
      for (int i = 0; i < 20; ++i) {
        std::ostringstream to;
        snapshot.write(to);
        written = to.str();
        if (written != good()) { return; }
      }
    });
    auto const got = walk(odo, walked, walked + 6);
    writes.join();
    auto const want = walk(other, 0, walked + 6);
    EXPECT_EQ(got.T_world_camera.t.x, want.T_world_camera.t.x);
    EXPECT_NE(saved(odo), good());
  }
  EXPECT_TRUE(written == good());
  std::ostringstream after;
  snapshot.write(after);
  EXPECT_TRUE(after.str() == good());
  after.setstate(std::ios::badbit);
  EXPECT_THROW(snapshot.write(after), ft::error);
  EXPECT_THROW(ft::map_snapshot().write(after), ft::bad_argument);
}

// ---- the format, as its documentation says

template <typename T>
T read(std::string const& file, std::size_t where) {
  T value;
  std::memcpy(&value, file.data() + where, sizeof value);
  return value;
}
template <typename T>
void write(std::string& file, std::size_t where, T value) {
  std::memcpy(&file[where], &value, sizeof value);
}

/// The hash of Fowler, Noll and Vo, 1a, of all but the last eight bytes.
std::string with_hash(std::string file) {
  std::uint64_t hash = 14695981039346656037u;
  for (std::size_t i = 0; i + 8 < file.size(); ++i) {
    hash ^= static_cast<unsigned char>(file[i]);
    hash *= 1099511628211u;
  }
  write(file, file.size() - 8, hash);
  return file;
}

struct field {
  std::string name;
  char kind;                      ///< i: int, f: float, d: double, m: mask or time, c: byte
  std::size_t begin, end;         ///< bytes
  std::vector<std::size_t> live;  ///< bytes of elements that are in use
};

struct layout {
  std::vector<field> fields;
  int slot = 0;      ///< that is in use
  int position = 0;  ///< of the newest keyframe
};

layout layout_of(std::string const& file) {
  std::size_t const text = at(read<std::int64_t>(file, 24));
  std::size_t next = 40 + text;
  auto const capacity_of = [&](std::string const& name) {
    std::size_t const line = file.find("\n" + name + ": ", 40);
    return at(std::stoi(file.substr(line + name.size() + 3)));
  };
  std::size_t const n = capacity_of("map_slots");
  std::size_t const positions = capacity_of("keyframes");
  std::size_t const capacity = capacity_of("keypoints of an image");
  layout all;
  struct column {
    char const* name;
    char kind;
    std::size_t rows, size, of_row;
  };
  std::vector<column> const columns{{"position", 'f', n, 4, 3},
                                    {"normal", 'f', n, 4, 3},
                                    {"min_distance", 'f', n, 4, 1},
                                    {"max_distance", 'f', n, 4, 1},
                                    {"orb", 'i', n, 4, 8},
                                    {"observations", 'i', n, 4, 1},
                                    {"number", 'i', n, 4, 1},
                                    {"visible", 'i', n, 4, 1},
                                    {"found", 'i', n, 4, 1},
                                    {"described", 'i', n, 4, 1},
                                    {"recent", 'i', n, 4, 64},
                                    {"mask", 'm', n, 8, 1},
                                    {"points made", 'i', 1, 4, 1},
                                    {"alive", 'i', 1, 4, 1},
                                    {"used", 'i', 1, 4, 1},
                                    {"keyframes made", 'i', 1, 4, 1},
                                    {"count", 'i', 1, 4, 1},
                                    {"T_cw", 'd', positions, 8, 12},
                                    {"time_ns", 'm', positions, 8, 1},
                                    {"neighbour", 'i', positions, 4, 1},
                                    {"shared", 'i', positions, 4, 1},
                                    {"keypoints", 'i', positions, 4, 1},
                                    {"x", 'f', positions * capacity, 4, 1},
                                    {"y", 'f', positions * capacity, 4, 1},
                                    {"right_x", 'f', positions * capacity, 4, 1},
                                    {"octave", 'i', positions * capacity, 4, 1},
                                    {"holder", 'i', positions * capacity, 4, 1},
                                    {"holder_number", 'i', positions * capacity, 4, 1},
                                    {"aligned", 'c', positions * capacity, 1, 1}};
  for (column const& c : columns) {
    std::size_t const bytes = c.rows * c.size * c.of_row;
    all.fields.push_back({c.name, c.kind, next, next + bytes, {}});
    next += bytes;
  }
  EXPECT_EQ(next + 8, file.size());
  auto const find = [&](std::string const& name) -> field& {
    for (field& f : all.fields) {
      if (f.name == name) { return f; }
    }
    throw std::out_of_range(name);
  };
  while (read<int>(file, find("number").begin + 4 * at(all.slot)) == 0) { ++all.slot; }
  all.position = (read<int>(file, find("keyframes made").begin) - 1) % static_cast<int>(positions);
  for (std::size_t i = 0; i < columns.size(); ++i) {
    column const& c = columns[i];
    std::size_t const row = c.rows == n           ? at(all.slot)
                            : c.rows == 1         ? 0
                            : c.rows == positions ? at(all.position)
                                                  : at(all.position) * capacity;
    std::size_t const first = all.fields[i].begin + row * c.size * c.of_row;
    all.fields[i].live = {first, first + c.size * (c.of_row - 1)};
  }
  return all;
}

/// Changes of an element: -1, the extreme ones, the capacities and one more; or NaN, infinity.
std::vector<std::function<void(std::string&, std::size_t)>> changes_of(char kind) {
  std::vector<std::function<void(std::string&, std::size_t)>> all;
  auto const add = [&](auto value) {
    all.emplace_back([value](std::string& file, std::size_t where) { write(file, where, value); });
  };
  double const infinity = std::numeric_limits<double>::infinity();
  double const nan = std::numeric_limits<double>::quiet_NaN();
  if (kind == 'i') {
    for (int const v : {-1, INT_MIN, INT_MAX, INT_MAX - 1, 0, 1, 3, 6, 7, 1024, 1025, 100000}) {
      add(v);
    }
  } else if (kind == 'm') {
    for (std::int64_t const v : {std::int64_t{-1}, std::numeric_limits<std::int64_t>::min(),
                                 std::numeric_limits<std::int64_t>::max(), std::int64_t{0},
                                 std::int64_t{64}, std::int64_t{1}}) {
      add(v);
    }
  } else if (kind == 'c') {
    for (int const v : {0, 1, 2, 255}) { add(static_cast<unsigned char>(v)); }
  } else {
    for (double const v : {nan, infinity, -infinity, 0.0, -1.0, 1e30, 1e-30, 1e9}) {
      if (kind == 'f') {
        add(static_cast<float>(v));
      } else {
        add(v);
      }
    }
    if (kind == 'd') { add(1e300); }
  }
  return all;
}

/// The indices, and what counts: no value beyond its limits is taken.
TEST(SavedMap, EachFieldIsRefusedOrHarmless) {
  layout const of = layout_of(good());
  odometry odo = made();
  std::map<std::string, int> refused, taken;
  for (field const& f : of.fields) {
    std::size_t const size = f.kind == 'c' ? 1 : f.kind == 'i' || f.kind == 'f' ? 4 : 8;
    for (auto const& change : changes_of(f.kind)) {
      for (int const everywhere : {0, 1}) {
        if (everywhere == 1 && !test::whole_effort()) { continue; }
        std::string file = good();
        if (everywhere != 0) {
          for (std::size_t i = f.begin; i < f.end; i += size) { change(file, i); }
        } else {
          for (std::size_t const i : f.live) { change(file, i); }
        }
        if (!refusal(odo, with_hash(file)).empty()) {
          ++refused[f.name];
          continue;
        }
        ++taken[f.name];
        walk(odo, walked, walked + test::effort(4));
      }
    }
  }
  for (field const& f : of.fields) {
    bool const any = f.name == "orb" || f.name == "recent" || f.name == "time_ns";
    EXPECT_EQ(refused[f.name] == 0, any) << f.name;
    RecordProperty(f.name, refused[f.name]);
  }
}

TEST(SavedMap, NumbersOutOfRangeAreNamed) {
  layout const of = layout_of(good());
  odometry odo = made();
  struct fault {
    char const* field;
    double value;
    char const* message;
  };
  std::vector<fault> const faults{
      {"described", -100, "descriptors given to a point -100, must be in [1, 1073741824]"},
      {"described", INT_MAX, "descriptors given to a point 2147483647"},
      {"visible", INT_MAX, "frames that had a point in view 2147483647"},
      {"found", -1, "frames that found a point -1"},
      {"points made", INT_MAX, "points made 2147483647, must be in [0, 1073741824]"},
      {"keyframes made", INT_MAX, "keyframes made 2147483647, must be in [0, 1073741824]"},
      {"count", 7, "keyframes in use 7, must be in [1, 6]"},
      {"count", 0, "keyframes in use 0, must be in [1, 6]"},
      {"used", 1025, "slots in use 1025, must be in [0, 1024]"},
      {"used", 0, "points alive"},
      {"alive", 1, "points alive 1, must be in"},
      {"observations", 7, "a point's observations 7"},
      {"number", 1 << 29, "a point's number 536870912"},
      {"mask", 64, "seen by a keyframe which it does not have"},
      {"mask", 0, "keyframes that see a point 0, must be in [1, "},
      {"neighbour", 1000, "a keyframe's neighbour 1000, must be in [0, "},
      {"shared", -1, "points shared with a neighbour -1"},
      {"keypoints", 100000, "keypoints 100000, must be in [0, "},
      {"octave", 3, "an octave 3, must be in [0, 2]"},
      {"holder", 1024, "a keypoint's slot 1024, must be in [-1, 1023]"},
      {"holder_number", -1, "the number of a keypoint's point -1"},
      {"position", NAN, "a point's coordinate nan"},
      {"normal", 2, "an entry of a normal 2, must be in [-1.001, 1.001]"},
      {"max_distance", INFINITY, "a point's max_distance inf"},
      {"min_distance", 0, "a point's min_distance 0"},
      {"x", 1e9, "a keypoint's x 1e+09, must be in [-1e+06, 1e+06]"},
      {"right_x", NAN, "a keypoint's right x nan"},
      {"T_cw", 0.5, "a rotation"},
      {"aligned", 2, "whether a keypoint is aligned 2, must be in [0, 1]"},
  };
  for (fault const& wrong : faults) {
    auto const f = std::find_if(of.fields.begin(), of.fields.end(),
                                [&](field const& any) { return any.name == wrong.field; });
    ASSERT_NE(f, of.fields.end()) << wrong.field;
    std::string file = good();
    std::size_t const where = f->live[0];
    switch (f->kind) {
      case 'i':
        write(file, where, static_cast<int>(wrong.value));
        break;
      case 'm':
        write(file, where, static_cast<std::int64_t>(wrong.value));
        break;
      case 'f':
        write(file, where, static_cast<float>(wrong.value));
        break;
      case 'c':
        write(file, where, static_cast<unsigned char>(wrong.value));
        break;
      default:
        write(file, where, wrong.value);
    }
    std::string const said = refusal(odo, with_hash(file));
    EXPECT_NE(said.find(wrong.message), std::string::npos)
        << wrong.field << " " << wrong.value << "; said: " << said;
  }
}

TEST(SavedMap, AnErrorLeavesTheOdometryAsItWas) {
  odometry kept = made();
  odometry odo = made();
  walk(kept, 0, walked);
  walk(odo, 0, walked);
  std::string file = good();
  write(file, layout_of(file).fields.back().live[0], -5);
  EXPECT_NE(refusal(odo, with_hash(file)), "");
  EXPECT_NE(refusal(odo, file), "") << "the hash";
  EXPECT_NE(refusal(odo, good().substr(0, 2000)), "");
  auto const a = walk(kept, walked, walked + 6);
  auto const b = walk(odo, walked, walked + 6);
  EXPECT_EQ(std::memcmp(&a.T_world_camera, &b.T_world_camera, sizeof a.T_world_camera), 0);
  EXPECT_EQ(saved(kept), saved(odo));
}

TEST(SavedMap, AFileHasNothingButTheMap) {
  odometry odo = made();
  walk(odo, 0, walked);
  EXPECT_EQ(saved(odo), good()) << "memory that was never written";
  odometry other = made();
  ASSERT_EQ(refusal(other, good()), "");
  EXPECT_EQ(saved(other), good());
}

TEST(SavedMap, AnOldVersionIsRefusedWithWords) {
  std::string file = good();
  write(file, 16, 1);
  odometry odo = made();
  EXPECT_EQ(refusal(odo, file),
            "ft: the map file has version 1, this ft reads version 3: the map has to be made anew");
}

/// A stream without an end that counts what it gave.
class endless : public std::streambuf {
public:
  explicit endless(std::string bytes) : bytes_(std::move(bytes)) {}
  std::size_t given = 0;

private:
  int_type underflow() override {
    byte_ = given < bytes_.size() ? bytes_[given] : 'x';
    ++given;
    setg(&byte_, &byte_, &byte_ + 1);
    return traits_type::to_int_type(byte_);
  }
  std::string bytes_;
  char byte_ = 0;
};

TEST(SavedMap, NoMoreIsReadThanTheHeadSays) {
  odometry odo = made();
  endless good_then_more(good());
  std::istream from(&good_then_more);
  odo.load_map(from);
  EXPECT_EQ(good_then_more.given, good().size());
  endless strange("no map at all, but very, very long");
  std::istream of_strange(&strange);
  EXPECT_THROW(odo.load_map(of_strange), ft::error);
  EXPECT_EQ(strange.given, 24u);
  for (std::size_t const where : {std::size_t{24}, std::size_t{32}}) {
    std::string file = good();
    write(file, where, std::int64_t{-1});
    endless claims(file);
    std::istream of_claims(&claims);
    EXPECT_THROW(odo.load_map(of_claims), ft::error);
    EXPECT_LT(claims.given, 4000u);
  }
}

TEST(SavedMap, OfAnotherRigIsRefusedByName) {
  ft::host_exec const exec(1);
  auto const said = [&](auto const& of, ft::odometry_params const& p = params()) {
    ft::odometry odo(exec, of, p);
    return refusal(odo, good());
  };
  EXPECT_EQ(said(rig()), "");
  EXPECT_EQ(said(ft::rectified_rig::make(camera(), 0.5)),
            "ft: the map was made with baseline 0.11 m, this odometry has 0.5 m");
  auto other = camera();
  other.fx = 300;
  EXPECT_EQ(said(ft::rectified_rig::make(other, 0.11)),
            "ft: the map was made with fx 200, this odometry has 300");
  other = camera();
  other.cy = std::nextafter(other.cy, 100.0f);
  EXPECT_EQ(said(ft::rectified_rig::make(other, 0.11)),
            "ft: the map was made with cy 90, this odometry has 90.00001");
  EXPECT_EQ(said(ft::rgbd_rig<>::make(camera(), 0.11)),
            "ft: the map was made with rig rectified pair, this odometry has camera with depth "
            "images");
  auto p = params();
  p.orb.width = 320;
  EXPECT_EQ(said(rig(), p),
            "ft: the map was made with image size 240 x 180 pixels, this odometry has 320 x 180 "
            "pixels");
  p = params();
  p.orb.levels = 4;
  EXPECT_EQ(said(rig(), p),
            "ft: the map was made with levels of the pyramid 3, this odometry has 4");
  p = params();
  p.orb.scale_factor = 1.3f;
  EXPECT_EQ(said(rig(), p), "ft: the map was made with scale factor 1.2, this odometry has 1.3");
  p = params();
  p.map_slots = 2048;
  EXPECT_EQ(said(rig(), p), "ft: the map was made with map_slots 1024, this odometry has 2048");
  p = params();
  p.keyframes = 7;
  EXPECT_EQ(said(rig(), p), "ft: the map was made with keyframes 6, this odometry has 7");
}

/// All numbers of all kinds of rigs are in the text: another one is another text.
TEST(SavedMap, TheOriginHasEachNumberOfARig) {
  ft::odometry_map_view const map{};
  auto const text = [&](auto const& of) {
    return ft::detail::map_origin(of, params().orb, map).text();
  };
  using lens = ft::kannala_brandt<float>;
  using radtan = ft::radtan4<float>;
  lens const fisheye{200, 201, 120, 90, 0.01f, 0.02f, 0.03f, 0.04f};
  radtan const narrow{200, 201, 120, 90, {0.1f, 0.2f, 0.01f, 0.02f}};
  ft::pose const T{ft::mat3<float>::identity(), {-0.1f, 0.01f, 0.02f}};
  auto const differs = [&](auto const& rig_of, auto const& change) {
    auto changed = rig_of;
    change(changed);
    EXPECT_NE(text(rig_of), text(changed));
  };
  ft::stereo_rig<lens, lens> const two{fisheye, fisheye, T};
  differs(two, [](auto& r) { r.left.k4 = 0; });
  differs(two, [](auto& r) { r.right.k1 = 0; });
  differs(two, [](auto& r) { r.T_rl.t.z = 0; });
  differs(two, [](auto& r) { r.T_rl.R.m[5] = 0.001f; });
  auto const pair = ft::distorted_pair<radtan>::make(narrow, narrow, T, camera());
  differs(pair, [](auto& r) { r.left.distortion[3] = 0; });
  differs(pair, [](auto& r) { r.right.fx = 1; });
  differs(pair, [](auto& r) { r.R_left.m[1] += 1e-12; });
  differs(pair, [](auto& r) { r.R_right.m[8] += 1e-12; });
  differs(pair, [](auto& r) { r.target.baseline = 1; });
  differs(pair, [](auto& r) { r.width = 100; });
  auto const depth = ft::rgbd_rig<radtan>::make(narrow, 0.08, 0.001f);
  differs(depth, [](auto& r) { r.depth_scale = 0.0002f; });
  differs(depth, [](auto& r) { r.camera.distortion[0] = 0; });
  auto const one = ft::monocular_rig<radtan>::make(narrow);
  differs(one, [](auto& r) { r.camera.cx = 0; });
  ft::multi_rig<2> const several{{{camera(), 0.1, T}, {camera(), 0, T}}};
  differs(several, [](auto& r) { r.of[1].T_cb.t.x = 0; });
  differs(several, [](auto& r) { r.of[1].used = false; });
  differs(several, [](auto& r) { r.of[0].baseline = 0.2; });
}

}  // namespace saved_map_test
#endif

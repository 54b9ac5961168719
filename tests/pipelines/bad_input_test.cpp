// SPDX-License-Identifier: Apache-2.0
// Input that cannot be or that says nothing, for a rectified pair and for pairs of several models:
// no baseline, overlaps beside the image, calibrations that cannot be inverted, an eye without a
// keypoint, descriptors that are all equal, map points where no camera can see them.
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <functional>
#include <limits>
#include <map>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/double_sphere.hpp"
#include "ft/cameras/kannala_brandt.hpp"
#include "ft/cameras/pinhole.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/frame.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/kernels/grid.hpp"
#include "ft/kernels/search/frustum.hpp"
#include "ft/kernels/search/last_frame.hpp"
#include "ft/kernels/search/local_map.hpp"
#include "ft/kernels/search/workspace.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/kernels/stereo/rectified.hpp"
#include "ft/pipelines/frame_tracker.hpp"
#include "ft/pipelines/orb_extractor.hpp"
#include "ft/pipelines/stereo_matcher.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"
#include "tests/support/tracking.hpp"

namespace bad_input {

using test::at;

constexpr int width = 320;
constexpr int height = 240;
constexpr float nan = std::numeric_limits<float>::quiet_NaN();
constexpr float inf = std::numeric_limits<float>::infinity();

// ---- the rigs ---------------------------------------------------------------------------------

using kb = ft::kannala_brandt<float>;
using pin = ft::pinhole<float>;
using sphere = ft::double_sphere<float>;
using tangential = ft::radtan5<float>;
using kb_pair = ft::stereo_rig<kb, kb>;
using mixed_pair = ft::stereo_rig<pin, kb>;
using sphere_pair = ft::stereo_rig<sphere, tangential>;

kb make_camera(kb const*) {
  return {141.0f, 140.5f, 159.5f, 119.5f, -0.012f, 0.003f, -0.002f, 0.0003f};
}
pin make_camera(pin const*) { return {170.0f, 170.0f, 160.5f, 118.5f}; }
sphere make_camera(sphere const*) { return {118.0f, 118.5f, 159.0f, 120.0f, -0.2f, 0.59f}; }
tangential make_camera(tangential const*) {
  return {168.0f, 167.0f, 161.0f, 119.0f, {-0.21f, 0.06f, 4e-4f, -3e-4f, -0.008f}};
}

/// Centres 0.2 m apart, not quite parallel.
template <typename Rig>
Rig make_rig(Rig const*) {
  ft::pose const T_rl{{{0.9998f, 0, -0.02f, 0, 1, 0, 0.02f, 0, 0.9998f}}, {-0.2f, 0.003f, 0.002f}};
  return {make_camera(static_cast<typename Rig::left_type const*>(nullptr)),
          make_camera(static_cast<typename Rig::right_type const*>(nullptr)), T_rl};
}
ft::rectified_rig make_rig(ft::rectified_rig const*) {
  return ft::rectified_rig::make({200.0f, 200.0f, 159.5f, 119.5f}, 0.2f);
}
template <typename Rig>
Rig a_rig() {
  return make_rig(static_cast<Rig const*>(nullptr));
}

/// Calls test(rig) for the pairs of any two cameras, or for these and the rectified one.
template <typename Test>
void for_each_pair(Test const& test) {
  {
    SCOPED_TRACE("kannala_brandt, kannala_brandt");
    test(a_rig<kb_pair>());
  }
  {
    SCOPED_TRACE("pinhole, kannala_brandt");
    test(a_rig<mixed_pair>());
  }
  {
    SCOPED_TRACE("double_sphere, radtan5");
    test(a_rig<sphere_pair>());
  }
}
template <typename Test>
void for_each_rig(Test const& test) {
  {
    SCOPED_TRACE("rectified");
    test(a_rig<ft::rectified_rig>());
  }
  for_each_pair(test);
}

ft::orb_params orb() {
  ft::orb_params p;
  p.width = width;
  p.height = height;
  p.features = 400;
  p.levels = 6;
  return p;
}
ft::tracker_params params() {
  ft::tracker_params p;
  p.orb = orb();
  p.map_slots = 700;
  p.local_points = 600;
  p.updates = 700;
  return p;
}

/// The message that a call throws as bad_argument; "" and a failure where it does not.
template <typename Call>
std::string refusal(Call const& call) {
  try {
    call();
  } catch (ft::bad_argument const& e) { return e.what(); }
  ADD_FAILURE() << "accepted";
  return {};
}
void expect_says(std::string const& message, std::vector<std::string> const& parts) {
  for (auto const& part : parts) {
    EXPECT_NE(message.find(part), std::string::npos) << "no '" << part << "' in: " << message;
  }
}

// ---- images -----------------------------------------------------------------------------------

using image = std::vector<std::uint8_t>;

ft::gray_view view(image const& i) { return {i.data(), width, height, width}; }
image flat() { return image(at(width * height), 90); }

/// What a camera sees of a textured plane at world z = 3, tilted so that depths differ.
template <typename Camera>
image render(Camera const& camera, ft::pose const& T_cw, image const& texture, int side) {
  auto const wide = camera.template cast<double>();
  auto const T_wc = T_cw.template cast<double>().inverse();
  image out = flat();
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      auto const ray = wide.unproject({static_cast<double>(u), static_cast<double>(v)});
      if (!ray.valid) { continue; }
      auto const d = T_wc.R * ray.direction;
      // n . p = 3 with n = (0.2, 0.1, 1)
      double const slope = 0.2 * d.x + 0.1 * d.y + d.z;
      double const t = (3 - (0.2 * T_wc.t.x + 0.1 * T_wc.t.y + T_wc.t.z)) / slope;
      if (!(t > 0) || t * std::sqrt(ft::dot(d, d)) > 50) { continue; }
      double const s = (T_wc.t.x + t * d.x + 100) * 45;
      double const r = (T_wc.t.y + t * d.y + 100) * 45;
      out[at(v * width + u)] = test::texture_at(texture, side, s, r);
    }
  }
  return out;
}

struct stereo_frame {
  image left, right;
};

/// Two frames of a short way: the first at the origin.
template <typename Rig>
std::array<stereo_frame, 2> make_frames(Rig const& rig) {
  constexpr int side = 400;
  image const texture = test::random_image(side, side, 5);
  std::array<stereo_frame, 2> frames;
  for (std::size_t i = 0; i < 2; ++i) {
    ft::pose T_cw = ft::pose::identity();
    T_cw.t = {-0.01f * static_cast<float>(i), 0, -0.03f * static_cast<float>(i)};
    if constexpr (Rig::rectified) {
      ft::pose T_rw = T_cw;
      T_rw.t.x -= rig.baseline_length().value;
      frames[i] = {render(rig.camera, T_cw, texture, side),
                   render(rig.camera, T_rw, texture, side)};
    } else {
      frames[i] = {render(rig.left, T_cw, texture, side),
                   render(rig.right, rig.T_rl * T_cw, texture, side)};
    }
  }
  return frames;
}

// ---- driving a tracker ------------------------------------------------------------------------

using test::expect_same;
using test::same_bits;
using test::snapshot;

template <typename T>
int count_of(std::vector<T> const& v, std::function<bool(T)> const& good) {
  return static_cast<int>(std::count_if(v.begin(), v.end(), good));
}
int held(snapshot const& s) {
  return count_of<int>(s.holder, [](int h) { return h >= 0; });
}
int with_depth(snapshot const& s) {
  return count_of<float>(s.depth, [](float d) { return d > 0; });
}

/// A tracker, and what a program round it does.
template <typename Exec, typename Rig>
struct driver {
  using tracker_type = ft::frame_tracker<Exec, Rig>;
  Exec const& exec;
  tracker_type tracker;
  test::frame_inputs<tracker_type> in;
  std::vector<ft::point_update> points;  ///< what first() found

  driver(Exec const& e, Rig const& rig, ft::tracker_params const& p = params())
      : exec(e), tracker(e, rig, p), in(tracker) {}
  driver(driver const&) = delete;
  driver& operator=(driver const&) = delete;

  static int numbers(tracker_type const& t) { return tracker_type::cameras * t.capacity(); }
  void images(image const& left, image const& right) {
    tracker.set_image(0, 0, view(left));
    tracker.set_image(0, 1, view(right));
  }
  snapshot result(bool local) {
    exec.wait();
    return test::take(tracker, 0, local ? in.local_count[0] : 0);
  }
  snapshot extract(stereo_frame const& f) {
    images(f.left, f.right);
    in.predicted[0] = ft::pose::identity();
    in.extract(exec);
    return result(false);
  }
  /// extract(), and a map of what it found: slot i is left keypoint i.
  snapshot first(stereo_frame const& f) {
    snapshot const s = extract(f);
    int const count = s.keypoints[0];
    std::vector<ft::descriptor> all(at(count));
    tracker.download_descriptors(exec, 0, all.data(), count);
    exec.wait();
    auto const& g = tracker.geometry();
    points.clear();
    for (int i = 0; i < count; ++i) {
      if (!(s.depth[at(i)] > 0)) { continue; }
      ft::vec3<float> const p = s.point[at(i)];
      float const distance = std::sqrt(ft::dot(p, p));
      float const farthest = distance * g.scale[s.octave[at(i)]];
      points.push_back({i,
                        1,
                        p,
                        {p.x / distance, p.y / distance, p.z / distance},
                        farthest / g.scale[g.levels - 1],
                        farthest,
                        all[at(i)]});
    }
    tracker.update_map(exec, 0, points.data(), static_cast<int>(points.size()));
    exec.wait();
    use_as_last(s);
    return s;
  }
  /// The first frame becomes the last one: its keypoints hold their points.
  void use_as_last(snapshot const& s) {
    std::fill(in.last_holder.begin(), in.last_holder.end(), -1);
    for (auto const& p : points) {
      in.last_holder[at(p.slot)] = p.slot;
      int const partner = s.partner[at(p.slot)];
      if (partner >= 0) { in.last_holder[at(partner)] = p.slot; }
    }
    in.predicted[0] = in.last_pose[0] = ft::pose::identity();
    in.local_count[0] = static_cast<int>(points.size());
    for (std::size_t i = 0; i < points.size(); ++i) { in.local_slots[i] = points[i].slot; }
  }
};

template <typename Backend>
class bad_input_test : public test::on_backend<Backend> {
protected:
  using exec_type = typename Backend::exec_type;
  Backend backend;
  exec_type const& exec() const { return backend.exec; }
};
TYPED_TEST_SUITE(bad_input_test, test::backends);

// ---- baselines --------------------------------------------------------------------------------

TYPED_TEST(bad_input_test, a_rectified_pair_without_a_baseline_is_refused_with_the_value) {
  using executor = typename TestFixture::exec_type;
  ft::orb_extractor<executor> const extractor(this->exec(), orb(), 2);
  std::vector<std::pair<float, std::string>> const bad{
      {0.0f, "0"},     {-0.0f, "-0"},     {-0.2f, "-0.2"}, {1e-7f, "1e-07"},
      {-1e-7f, "-1e"}, {1e-30f, "1e-30"}, {nan, "nan"},    {inf, "inf"}};
  for (auto const& [value, text] : bad) {
    SCOPED_TRACE(text);
    auto rig = a_rig<ft::rectified_rig>();
    rig.baseline = value;
    expect_says(refusal([&] { ft::rectified_rig::make(rig.camera, rig.baseline); }),
                {"baseline is " + text});
    expect_says(refusal([&] { ft::stereo_matcher<executor>(rig, extractor); }),
                {"baseline is " + text});
    expect_says(refusal([&] { ft::frame_tracker<executor>(this->exec(), rig, params()); }),
                {"baseline is " + text});
  }
}

TYPED_TEST(bad_input_test, a_pair_of_cameras_without_a_baseline_is_refused_with_the_value) {
  using executor = typename TestFixture::exec_type;
  ft::orb_extractor<executor> const extractor(this->exec(), orb(), 2);
  for_each_pair([&](auto good) {
    using rig_type = decltype(good);
    std::vector<std::pair<ft::vec3<float>, std::string>> const bad{
        {{0, 0, 0}, "baseline is 0"},
        {{-1e-7f, 0, 0}, "baseline is 1e-07"},
        {{0, 1e-9f, 0}, "baseline is 1"},
        {{nan, 0, 0}, "rig translation is"},
        {{0, 0, inf}, "rig translation is inf"}};
    for (auto const& [t, text] : bad) {
      SCOPED_TRACE(text);
      auto rig = good;
      rig.T_rl.t = t;
      expect_says(refusal([&] { ft::stereo_matcher<executor, rig_type>(rig, extractor); }), {text});
      expect_says(
          refusal([&] { ft::frame_tracker<executor, rig_type>(this->exec(), rig, params()); }),
          {text});
    }
    for (ft::vec3<float> const t :
         {ft::vec3<float>{0.2f, 0, 0}, ft::vec3<float>{0, -0.2f, 0}, ft::vec3<float>{0, 0, 0.1f}}) {
      auto rig = good;  // to the left, above, behind: all are pairs
      rig.T_rl.t = t;
      EXPECT_NO_THROW((ft::stereo_matcher<executor, rig_type>(rig, extractor)));
    }
  });
}

// ---- overlaps ---------------------------------------------------------------------------------

TYPED_TEST(bad_input_test, an_overlap_that_is_no_interval_is_refused_with_its_ends) {
  using executor = typename TestFixture::exec_type;
  struct bad {
    ft::stereo_overlap overlap;
    std::vector<std::string> text;
  };
  for (auto const& b : std::vector<bad>{{{200, 100.5f}, {"[200, 100.5]"}},
                                        {{nan, 100}, {"nan", "100]"}},
                                        {{100, nan}, {"[100, ", "nan"}},
                                        {{nan, nan}, {"nan"}},
                                        {{inf, -inf}, {"[inf, -inf]"}}}) {
    SCOPED_TRACE(b.text[0]);
    auto const message = refusal([&] {
      ft::orb_extractor<executor>(this->exec(), orb(), 3, {{0, 10}, {5, 5}, b.overlap});
    });
    expect_says(message, b.text);
    expect_says(message, {"image 2"});
    auto p = params();
    p.overlap[1] = b.overlap;
    for_each_pair([&](auto rig) {
      auto const said =
          refusal([&] { ft::frame_tracker<executor, decltype(rig)>(this->exec(), rig, p, 2); });
      expect_says(said, b.text);
      expect_says(said, {"overlap[1]"});
    });
    // Also for a rectified pair, which has no use for it.
    EXPECT_THROW(ft::frame_tracker<executor>(this->exec(), a_rig<ft::rectified_rig>(), p),
                 ft::bad_argument);
  }
}

/// Keypoints of an image with the given overlap, in the order of the output.
struct keypoint {
  float x, y, angle;
  int octave;
  ft::descriptor orb;
};
struct listed {
  std::vector<keypoint> all;
  int mono = 0;
};
template <typename Exec>
std::vector<listed> read(Exec const& exec, ft::orb_extractor<Exec> const& extractor) {
  auto const kp = extractor.keypoints();
  auto const count = test::from_exec(exec, static_cast<int const*>(kp.count), at(kp.batch));
  auto const mono = test::from_exec(exec, extractor.mono_count(), at(kp.batch));
  auto const x = test::column<ft::field::x>(exec, kp);
  auto const y = test::column<ft::field::y>(exec, kp);
  auto const angle = test::column<ft::field::angle>(exec, kp);
  auto const octave = test::column<ft::field::octave>(exec, kp);
  auto const descriptors = test::column<ft::field::orb>(exec, kp);
  std::vector<listed> images;
  for (int b = 0; b < kp.batch; ++b) {
    listed l;
    l.mono = mono[at(b)];
    for (int i = 0; i < count[at(b)]; ++i) {
      auto const k = at(b * kp.capacity + i);
      l.all.push_back({x[k], y[k], angle[k], octave[k], descriptors[k]});
    }
    images.push_back(l);
  }
  return images;
}

TYPED_TEST(bad_input_test, every_keypoint_is_on_one_side_of_any_overlap) {
  using executor = typename TestFixture::exec_type;
  image const pixels = test::random_image(width, height, 3);
  std::vector<ft::stereo_overlap> overlaps{
      {0, 0},        {0, 1e9f},  {-inf, inf}, {100, 200}, {60, 60},     {320, 600},
      {-300, -0.1f}, {inf, inf}, {-inf, 80},  {150, inf}, {-inf, -inf}, {3.4e38f, 3.4e38f}};
  auto const n = static_cast<int>(overlaps.size());
  auto const extract = [&](std::vector<ft::stereo_overlap> const& with) {
    ft::orb_extractor<executor> extractor(this->exec(), orb(), n, with);
    for (int i = 0; i < n; ++i) { extractor.upload(this->exec(), i, view(pixels)); }
    extractor.extract(this->exec());
    this->exec().wait();
    return read(this->exec(), extractor);
  };
  auto const plain = extract({});
  overlaps[4].left = overlaps[4].right = plain[0].all[5].x;
  auto const split = extract(overlaps);
  ASSERT_GT(plain[0].all.size(), 300u);
  EXPECT_EQ(plain[0].mono, static_cast<int>(plain[0].all.size()));
  for (std::size_t i = 0; i < overlaps.size(); ++i) {
    SCOPED_TRACE(i);
    std::vector<keypoint> want;
    std::vector<keypoint> inside;
    for (auto const& k : plain[0].all) {
      bool const in = k.x >= overlaps[i].left && k.x <= overlaps[i].right;
      (in ? inside : want).push_back(k);
    }
    EXPECT_EQ(split[i].mono, static_cast<int>(want.size()));
    want.insert(want.end(), inside.rbegin(), inside.rend());
    ASSERT_EQ(split[i].all.size(), want.size());
    for (std::size_t k = 0; k < want.size(); ++k) {
      EXPECT_EQ(split[i].all[k].x, want[k].x);
      EXPECT_EQ(split[i].all[k].y, want[k].y);
      EXPECT_EQ(ft::hamming(split[i].all[k].orb, want[k].orb), 0);
    }
  }
  EXPECT_EQ(split[1].mono, 0);
  EXPECT_EQ(split[2].mono, 0);
  EXPECT_LT(split[4].mono, split[0].mono) << "a single column is an overlap";
  for (int const i : {0, 5, 6, 7, 10, 11}) { EXPECT_EQ(split[at(i)].mono, plain[0].mono); }
}

TYPED_TEST(bad_input_test, nothing_is_matched_where_an_overlap_is_empty) {
  using executor = typename TestFixture::exec_type;
  for_each_pair([&](auto rig) {
    auto const frames = make_frames(rig);
    auto const run = [&](ft::stereo_overlap left, ft::stereo_overlap right) {
      auto p = params();
      p.overlap[0] = left;
      p.overlap[1] = right;
      driver<executor, decltype(rig)> d(this->exec(), rig, p);
      return d.extract(frames[0]);
    };
    auto const sorted = [](snapshot const& s, int c) {
      std::vector<std::pair<float, float>> points;
      auto const capacity = static_cast<int>(s.depth.size());
      for (int i = 0; i < s.keypoints[at(c)]; ++i) {
        points.emplace_back(s.x[at(c * capacity + i)], s.y[at(c * capacity + i)]);
      }
      std::sort(points.begin(), points.end());
      return points;
    };
    ft::stereo_overlap const whole{0, 1e9f};
    auto const full = run(whole, whole);
    EXPECT_GT(with_depth(full), 40);
    for (auto const& empty : {ft::stereo_overlap{0, 0}, ft::stereo_overlap{320, 1e9f},
                              ft::stereo_overlap{-50, -1}, ft::stereo_overlap{inf, inf}}) {
      for (auto const& s : {run(empty, whole), run(whole, empty), run(empty, empty)}) {
        EXPECT_EQ(with_depth(s), 0);
        EXPECT_EQ(count_of<int>(s.partner, [](int p) { return p != -1; }), 0);
        for (auto const& p : s.point) { EXPECT_EQ(p.z, 0.0f); }
        EXPECT_EQ(sorted(s, 0), sorted(full, 0));
        EXPECT_EQ(sorted(s, 1), sorted(full, 1));
      }
    }
    auto const halved = run({-inf, 200}, {80, inf});
    EXPECT_GT(with_depth(halved), 10);
    for (std::size_t i = 0; i < halved.depth.size(); ++i) {
      if (!(halved.depth[i] > 0)) { continue; }
      EXPECT_LE(halved.x[i], 200.0f);
      EXPECT_GE(halved.x[at(halved.partner[i])], 80.0f);
    }
  });
}

// ---- calibrations that cannot be inverted -----------------------------------------------------

/// Says valid and answers with another ray in a corner of the image.
template <typename Scalar>
struct liar : ft::pinhole<Scalar> {
  static constexpr char const* name = "liar";
  FT_HOST_DEVICE ft::ray<Scalar> unproject(ft::vec2<Scalar> pixel) const {
    auto r = ft::pinhole<Scalar>::unproject(pixel);
    if (pixel.x > Scalar(300) && pixel.y > Scalar(200)) {
      r.direction.x = r.direction.x + Scalar(1);
    }
    return r;
  }
  template <typename U>
  FT_HOST_DEVICE liar<U> cast() const {
    return {ft::pinhole<Scalar>::template cast<U>()};
  }
};

template <typename Exec, typename Left, typename Right>
void expect_refused(Exec const& exec, Left const& left, Right const& right,
                    std::vector<std::string> const& parts) {
  using rig_type = ft::stereo_rig<Left, Right>;
  rig_type const rig{left, right, a_rig<kb_pair>().T_rl};
  SCOPED_TRACE(parts[0]);
  ft::orb_extractor<Exec> const extractor(exec, orb(), 2);
  expect_says(refusal([&] { ft::stereo_matcher<Exec, rig_type>(rig, extractor); }), parts);
  expect_says(refusal([&] { ft::frame_tracker<Exec, rig_type>(exec, rig, params()); }), parts);
}

TYPED_TEST(bad_input_test, cameras_that_cannot_be_inverted_in_the_image_are_refused_with_numbers) {
  auto const good = make_camera(static_cast<kb const*>(nullptr));
  std::string const size = "320 x 240";
  // Folds at theta = 0.41, 38 pixels from the centre.
  kb folded = good;
  folded.k1 = -2;
  folded.k2 = folded.k3 = folded.k4 = 0;
  expect_refused(this->exec(), folded, good, {"kannala_brandt", size, "must be at least 0.25"});
  expect_refused(this->exec(), good, folded, {"kannala_brandt", size, "must be at least 0.25"});
  // Largest radius 2 / 3 sqrt(1 / 9): 0.22 of the focal length, 37 pixels.
  tangential barrel = make_camera(static_cast<tangential const*>(nullptr));
  for (float& k : barrel.distortion) { k = 0; }
  barrel.distortion[0] = -3;
  expect_refused(this->exec(), good, barrel, {"radtan5", size, "must be at least 0.25"});
  // A circle of radius fx / sqrt(2 alpha - 1) = 50 pixels.
  sphere narrow = make_camera(static_cast<sphere const*>(nullptr));
  narrow.fx = narrow.fy = 50;
  narrow.alpha = 1;
  expect_refused(this->exec(), narrow, good, {"double_sphere", size, "must be at least 0.25"});
  // Of the wrong image: the principal point of a camera with ten times the resolution.
  pin const pinhole = make_camera(static_cast<pin const*>(nullptr));
  kb other = good;
  other.cx = 1600;
  other.cy = 1200;
  expect_refused(this->exec(), pinhole, other, {"kannala_brandt", size, "is 0 (0 of 4225)"});
  liar<float> lies;
  static_cast<ft::pinhole<float>&>(lies) = pinhole;
  expect_refused(this->exec(), lies, good,
                 {"liar", size, "rays do not project back", "misses it by 170"});
}

TYPED_TEST(bad_input_test, lenses_with_dark_corners_are_accepted) {
  using executor = typename TestFixture::exec_type;
  auto const accepted = [&](auto const& camera, int w, int h, double dark) {
    auto p = orb();
    p.width = w;
    p.height = h;
    ft::orb_extractor<executor> const extractor(this->exec(), p, 2);
    using rig_type = ft::stereo_rig<std::decay_t<decltype(camera)>, std::decay_t<decltype(camera)>>;
    rig_type const rig{camera, camera, a_rig<kb_pair>().T_rl};
    EXPECT_NO_THROW((ft::stereo_matcher<executor, rig_type>(rig, extractor)));
    EXPECT_NEAR(1 - ft::inspect_image_domain(camera, w, h).share_with_ray(), dark, 0.03);
  };
  // Circles of 90 degrees off the axis: radius 120 in 320 x 240 and 90 in 320 x 180.
  float const per_radian = 2 / 3.14159265f;
  accepted(kb{120 * per_radian, 120 * per_radian, 159.5f, 119.5f, 0, 0, 0, 0}, 320, 240, 0.411);
  accepted(kb{90 * per_radian, 90 * per_radian, 159.5f, 89.5f, 0, 0, 0, 0}, 320, 180, 0.558);
  // Radius fx / sqrt(2 alpha - 1).
  accepted(sphere{60, 60, 159.5f, 119.5f, -0.2f, 0.625f}, 320, 240, 0.411);
  // 2 / 3 sqrt(1 / 1.5) of 250: 136 pixels.
  accepted(tangential{250, 250, 159.5f, 119.5f, {-0.5f, 0, 0, 0, 0}}, 320, 240, 0.288);
  accepted(a_rig<sphere_pair>().left, width, height, 0.0);
  accepted(a_rig<sphere_pair>().right, width, height, 0.0);
}

// ---- an eye without a keypoint ----------------------------------------------------------------

enum class call { extract, track_motion, track_local, track };

TYPED_TEST(bad_input_test, an_eye_without_a_keypoint_leaves_nothing_stale) {
  using executor = typename TestFixture::exec_type;
  for_each_rig([&](auto rig) {
    using rig_type = decltype(rig);
    auto const frames = make_frames(rig);
    // What a tracker of its own finds.
    driver<executor, rig_type> alone(this->exec(), rig);
    auto const seen_first = alone.first(frames[0]);
    alone.images(frames[1].left, frames[1].right);
    alone.in.track_motion(this->exec());
    auto const seen_motion = alone.result(false);
    alone.in.track_local(this->exec());
    auto const seen_local = alone.result(true);
    ASSERT_GT(alone.points.size(), 40u);
    ASSERT_GT(seen_motion.inliers, 50);
    ASSERT_GE(seen_local.inliers, 50);

    driver<executor, rig_type> d(this->exec(), rig);
    std::vector<call> calls = {call::track_local, call::track};
    if (test::whole_effort()) { calls.insert(calls.begin(), {call::extract, call::track_motion}); }
    for (int dark = 1; dark <= 3; ++dark) {  // bit 0: left, bit 1: right
      for (call const c : calls) {
        SCOPED_TRACE("without keypoints: " + std::to_string(dark) + ", call " +
                     std::to_string(static_cast<int>(c)));
        expect_same(d.first(frames[0]), seen_first);
        d.images((dark & 1) != 0 ? flat() : frames[1].left,
                 (dark & 2) != 0 ? flat() : frames[1].right);
        bool local = false;
        if (c == call::extract) { d.in.extract(this->exec()); }
        if (c == call::track_motion || c == call::track_local) { d.in.track_motion(this->exec()); }
        if (c == call::track_local) {
          this->exec().wait();
          d.in.track_local(this->exec());
          local = true;
        }
        if (c == call::track) {
          d.in.track(this->exec());
          local = true;
        }
        auto const s = d.result(local);
        bool const left_dark = (dark & 1) != 0;
        EXPECT_EQ(s.keypoints[0], left_dark ? 0 : seen_motion.keypoints[0]);
        if (rig_type::rectified) {
          EXPECT_EQ(s.keypoints.size(), 1u);
        } else {
          EXPECT_EQ(s.keypoints[1], (dark & 2) != 0 ? 0 : seen_motion.keypoints[1]);
        }
        EXPECT_EQ(with_depth(s), 0) << "a depth from one eye";
        EXPECT_EQ(count_of<float>(s.depth, [](float z) { return z != -1; }), 0);
        EXPECT_EQ(count_of<int>(s.partner, [](int p) { return p != -1; }), 0);
        for (auto const& p : s.point) { EXPECT_TRUE(p.x == 0 && p.y == 0 && p.z == 0); }
        if (!local) { EXPECT_LE(s.inliers, s.matches); }
        // Nobody holds anything in the dark eye.
        auto const capacity = static_cast<int>(s.depth.size());
        for (int number = 0; number < static_cast<int>(s.holder.size()); ++number) {
          if (number % capacity >= s.keypoints[at(number / capacity)]) {
            EXPECT_EQ(s.holder[at(number)], -1);
          }
        }
        // The eye that sees goes on alone: the left one always, the right one in the local map;
        // from the last frame it is searched only where the left window held a keypoint.
        bool const can_match =
            (!left_dark && c != call::extract) || (!rig_type::rectified && dark == 1 && local);
        if (can_match) {
          EXPECT_GT(held(s), 30);
          EXPECT_EQ(s.inliers, held(s));
        } else {
          EXPECT_EQ(s.matches, 0);
          EXPECT_EQ(s.inliers, 0);
          EXPECT_EQ(held(s), 0);
          EXPECT_EQ(std::memcmp(&s.T_cw, d.in.predicted.data(), sizeof(ft::pose)), 0);
        }
        // With the frame of one eye as the last one nothing breaks, either.
        std::copy(s.holder.begin(), s.holder.end(), d.in.last_holder.begin());
        d.images(frames[1].left, frames[1].right);
        d.in.track_motion(this->exec());
        auto const next = d.result(false);
        EXPECT_EQ(next.keypoints, seen_motion.keypoints);
        EXPECT_TRUE(same_bits(next.depth, seen_motion.depth) &&
                    same_bits(next.partner, seen_motion.partner));
        if (!can_match) { EXPECT_EQ(next.matches, 0); }
        // And the way goes on as if nothing had been.
        expect_same(d.first(frames[0]), seen_first);
        d.images(frames[1].left, frames[1].right);
        d.in.track_motion(this->exec());
        expect_same(d.result(false), seen_motion);
        d.in.track_local(this->exec());
        expect_same(d.result(true), seen_local);
        if (this->HasFailure()) { return; }
      }
    }
  });
}

// ---- descriptors that are all equal -----------------------------------------------------------

/// What section 5 of the specification says of a pair, told plainly.
struct stereo_answer {
  float right_x = -1, depth = -1;
};
struct oracle_tally {
  int candidates = 0;  ///< left keypoints with two or more nearest right ones
  int kept = 0;
};

class rectified_oracle {
public:
  rectified_oracle(ft::pyramid_geometry const& g, std::vector<std::uint8_t> slab, float bf,
                   float baseline)
      : g_(g), slab_(std::move(slab)), bf_(bf), baseline_(baseline) {}

  std::vector<stereo_answer> operator()(std::vector<keypoint> const& left,
                                        std::vector<keypoint> const& right,
                                        oracle_tally& seen) const {
    std::vector<stereo_answer> out(left.size());
    std::vector<std::pair<int, std::size_t>> scores;
    for (std::size_t i = 0; i < left.size(); ++i) {
      int const sad = refine(left[i], right, out[i], seen);
      if (sad >= 0) { scores.emplace_back(sad, i); }
    }
    std::sort(scores.begin(), scores.end());
    if (scores.empty()) { return out; }
    float const median = static_cast<float>(scores[scores.size() / 2].first);
    for (auto const& [sad, i] : scores) {
      if (static_cast<float>(sad) >= 1.5f * 1.4f * median) {
        out[i] = {};
      } else {
        ++seen.kept;
      }
    }
    return out;
  }

private:
  /// The pixel of an image's level.
  int pixel(int eye, int level, int x, int y) const {
    auto const l = at(level);
    return slab_[at(eye * g_.bytes + g_.offset[l] + std::ptrdiff_t{g_.stride[l]} * y + x)];
  }
  static int round(float v) { return static_cast<int>(std::round(v)); }

  int refine(keypoint const& l, std::vector<keypoint> const& right, stereo_answer& out,
             oracle_tally& seen) const {
    int best = 256;
    std::size_t best_j = 0;
    int equals = 0;
    for (std::size_t j = 0; j < right.size(); ++j) {
      keypoint const& r = right[j];
      float const band = 2 * g_.scale[r.octave];
      auto const row = static_cast<float>(static_cast<int>(l.y));
      if (row < std::floor(r.y - band) || row > std::ceil(r.y + band)) { continue; }
      if (std::abs(l.octave - r.octave) > 1) { continue; }
      if (r.x < l.x - bf_ / baseline_ || r.x > l.x) { continue; }
      int const distance = ft::hamming(l.orb, r.orb);
      equals = distance < best ? 1 : equals + static_cast<int>(distance == best);
      if (distance < best) {
        best = distance;
        best_j = j;
      }
    }
    seen.candidates += static_cast<int>(equals > 1);
    if (best >= 75) { return -1; }
    float const inv = g_.inv_scale[l.octave];
    int const ul = round(l.x * inv);
    int const vl = round(l.y * inv);
    int const ur = round(right[best_j].x * inv);
    if (ur < 0 || ur + 11 >= g_.width[l.octave]) { return -1; }
    std::array<int, 11> sad{};
    for (int shift = -5; shift <= 5; ++shift) {
      for (int dy = -5; dy <= 5; ++dy) {
        for (int dx = -5; dx <= 5; ++dx) {
          sad[at(shift + 5)] += std::abs(pixel(0, l.octave, ul + dx, vl + dy) -
                                         pixel(1, l.octave, ur + shift + dx, vl + dy));
        }
      }
    }
    auto const lowest = std::min_element(sad.begin(), sad.end());
    auto const b = static_cast<int>(lowest - sad.begin());
    if (b == 0 || b == 10) { return -1; }
    auto const d1 = static_cast<float>(sad[at(b - 1)]);
    auto const d2 = static_cast<float>(*lowest);
    auto const d3 = static_cast<float>(sad[at(b + 1)]);
    float const delta = (d1 - d3) / (2.0f * (d1 + d3 - 2.0f * d2));
    if (!(delta >= -1 && delta <= 1)) { return -1; }
    float u = g_.scale[l.octave] * (static_cast<float>(ur) + static_cast<float>(b - 5) + delta);
    float disparity = l.x - u;
    if (!(disparity >= 0 && disparity < bf_ / baseline_)) { return -1; }
    if (disparity <= 0) {
      disparity = 0.01f;
      u = l.x - 0.01f;
    }
    out = {u, bf_ / disparity};
    return *lowest;
  }

  ft::pyramid_geometry g_;
  std::vector<std::uint8_t> slab_;
  float bf_, baseline_;
};

/// The same small patch over and over. @param brighter added to every pixel
image periodic(int period_x, int period_y, int shift, int brighter) {
  image const patch = test::random_image(period_x, period_y, 9);
  image out(at(width * height));
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      int const grey = patch[at((y % period_y) * period_x + (x + shift) % period_x)];
      out[at(y * width + x)] = static_cast<std::uint8_t>(std::min(grey, 250) + brighter);
    }
  }
  return out;
}

template <typename Exec>
void expect_rectified_as_told(Exec const& exec, ft::orb_extractor<Exec> const& extractor,
                              int least_ambiguous, int least_kept) {
  auto const rig = a_rig<ft::rectified_rig>();
  ft::stereo_matcher<Exec> matcher(rig, extractor);
  matcher.match(exec, extractor);
  exec.wait();
  auto const images = read(exec, extractor);
  auto const& g = extractor.geometry();
  rectified_oracle const oracle(
      g,
      test::from_exec(exec, static_cast<std::uint8_t const*>(extractor.pyramid().data),
                      at(2 * g.bytes)),
      rig.bf(), rig.baseline_length().value);
  oracle_tally seen;
  auto const want = oracle(images[0].all, images[1].all, seen);
  auto const depth = test::column<ft::field::depth>(exec, matcher.matches());
  auto const right_x = test::column<ft::field::right_x>(exec, matcher.matches());
  for (std::size_t i = 0; i < want.size(); ++i) {
    EXPECT_EQ(right_x[i], want[i].right_x) << i;
    EXPECT_EQ(depth[i], want[i].depth) << i;
  }
  EXPECT_GE(seen.candidates, least_ambiguous);
  EXPECT_GE(seen.kept, least_kept);
}

TYPED_TEST(bad_input_test, a_periodic_image_is_matched_as_the_rules_say) {
  using executor = typename TestFixture::exec_type;
  auto p = orb();
  p.levels = 1;  // where the period is one of whole pixels
  ft::orb_extractor<executor> extractor(this->exec(), p, 2, {{0, 1e9f}, {0, 1e9f}});
  for (int const shift : {0, 11}) {
    // Equal patches have equal descriptors. Where they are equal pixel by pixel every score is 0,
    // and so is the limit for outliers: nothing is left. One grey level brighter, all have one
    // score.
    int const brighter = shift == 0 ? 0 : 1;
    image const left = periodic(40, 30, 0, 0);
    image const right = periodic(40, 30, shift, brighter);
    extractor.upload(this->exec(), 0, view(left));
    extractor.upload(this->exec(), 1, view(right));
    extractor.extract(this->exec());
    this->exec().wait();
    expect_rectified_as_told(this->exec(), extractor, 100, brighter == 0 ? 0 : 50);

    for_each_pair([&](auto rig) {
      ft::stereo_matcher<executor, decltype(rig)> matcher(rig, extractor);
      matcher.match(this->exec(), extractor);
      this->exec().wait();
      auto const images = read(this->exec(), extractor);
      auto const depth = test::from_exec(this->exec(), matcher.depth(), at(extractor.capacity()));
      int ambiguous = 0;
      for (std::size_t i = 0; i < images[0].all.size(); ++i) {
        std::vector<int> distances;
        for (auto const& r : images[1].all) {
          distances.push_back(ft::hamming(images[0].all[i].orb, r.orb));
        }
        std::sort(distances.begin(), distances.end());
        if (10 * distances[0] >= 7 * distances[1]) {
          EXPECT_EQ(depth[i], -1.0f) << "matched against the ratio test";
          ++ambiguous;
        }
      }
      EXPECT_GT(ambiguous, 100);
    });
  }
}

TYPED_TEST(bad_input_test, stereo_with_equal_descriptors) {
  using executor = typename TestFixture::exec_type;
  for_each_rig([&](auto rig) {
    using rig_type = decltype(rig);
    auto const frames = make_frames(rig);
    ft::orb_extractor<executor> extractor(this->exec(), orb(), 2, {{0, 1e9f}, {0, 1e9f}});
    extractor.upload(this->exec(), 0, view(frames[0].left));
    extractor.upload(this->exec(), 1, view(frames[0].right));
    extractor.extract(this->exec());
    ft::stereo_matcher<executor, rig_type> matcher(rig, extractor);
    matcher.match(this->exec(), extractor);
    this->exec().wait();
    auto const n = at(extractor.capacity());
    auto const matched = [&] {
      auto const depth = test::from_exec(this->exec(), matcher.depth(), n);
      return count_of<float>(depth, [](float d) { return d > 0; });
    };
    ASSERT_GT(matched(), 40);

    auto const kp = extractor.keypoints();
    for (std::uint8_t const byte : {std::uint8_t{0x00}, std::uint8_t{0x5a}, std::uint8_t{0xff}}) {
      ft::fill_bytes(this->exec(), ft::array_of<ft::field::orb>(kp), byte,
                     2 * n * sizeof(ft::descriptor));
      if constexpr (rig_type::rectified) {
        expect_rectified_as_told(this->exec(), extractor, 100, 1);
      } else {
        matcher.match(this->exec(), extractor);
        this->exec().wait();
        EXPECT_EQ(matched(), 0);
        auto const partner =
            test::from_exec(this->exec(), matcher.fisheye_matches().partner, 2 * n);
        EXPECT_EQ(count_of<int>(partner, [](int q) { return q != -1; }), 0);
      }
    }
    if constexpr (!rig_type::rectified) {  // a single candidate has no second one to be better than
      int const one = 1;
      ft::copy(this->exec(), kp.count + 1, &one, 1);
      this->exec().wait();
      matcher.match(this->exec(), extractor);
      this->exec().wait();
      EXPECT_EQ(matched(), 0);
    }
  });
}

/// A frame of a rectified pair, the one before, and map points; every descriptor of a keypoint is
/// the same.
struct search_scene {
  static constexpr int keypoints = 350;
  static constexpr int points = 300;
  std::vector<float> x, y, angle, right_x;
  std::vector<int> octave, holder;
  std::vector<float> last_angle;
  std::vector<int> last_octave, last_holder;
  std::vector<ft::vec3<float>> position, normal;
  std::vector<float> min_distance, max_distance;
  std::vector<int> observations;
  std::vector<int> slots;  ///< the local map
  int bits = 0;            ///< by which the points' descriptors differ from the keypoints'
};

search_scene make_scene(unsigned seed, int bits, ft::rectified_rig const& rig,
                        ft::pyramid_geometry const& g) {
  std::mt19937 random(seed);
  auto const below = [&](int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); };
  auto const real = [&](float low, float high) {
    return low + (high - low) * static_cast<float>(random() >> 8) / 16777216.0f;
  };
  search_scene s;
  s.bits = bits;
  for (int i = 0; i < search_scene::keypoints; ++i) {
    s.x.push_back(real(0, width));
    s.y.push_back(real(0, height));
    s.octave.push_back(below(3) + 2 * below(2));
    s.angle.push_back(40.0f * static_cast<float>(below(9)));
    s.right_x.push_back(below(2) == 0 ? -1.0f : s.x.back() - real(5, 40));
    s.holder.push_back(below(5) == 0 ? below(search_scene::points) : -1);
    s.last_octave.push_back(below(3) + 2 * below(2));
    s.last_angle.push_back(40.0f * static_cast<float>(below(3)));
    s.last_holder.push_back(below(6) == 0 ? -1 : below(search_scene::points));
  }
  for (int i = 0; i < search_scene::points; ++i) {
    float const z = below(10) == 0 ? -real(1, 4) : real(1, 8);
    ft::vec3<float> const p{(real(-20, width + 20) - rig.camera.cx) * z / rig.camera.fx,
                            (real(-20, height + 20) - rig.camera.cy) * z / rig.camera.fy, z};
    float const distance = std::sqrt(ft::dot(p, p));
    float const side = below(8) == 0 ? -1.0f : 1.0f;
    s.position.push_back(p);
    s.normal.push_back({side * p.x / distance, side * p.y / distance, side * p.z / distance});
    s.max_distance.push_back(distance * g.scale[below(5)] * 0.93f);
    s.min_distance.push_back(below(9) == 0 ? 2 * distance : 0.3f * distance);
    s.observations.push_back(below(4) == 0 ? 0 : 1 + below(5));
    s.slots.push_back(below(12) == 0 ? -1 : below(search_scene::points));
  }
  return s;
}

struct search_answer {
  std::vector<int> holder;
  int matches = 0;
};

/// One window of section 9 or 10.
struct told_window {
  float x, y, radius, right_x;
  int low, high;  ///< octaves; high below 0: no upper limit
  int slot;
};

/// Greedy, in the windows' order. @param taken gets per window the keypoint
int search_plainly(search_scene const& s, std::vector<told_window> const& windows, bool ratio_test,
                   std::vector<int>& holder, std::vector<int>& taken) {
  float const inv_x = 64.0f / width;
  float const inv_y = 48.0f / height;
  std::vector<std::array<int, 2>> cells;
  for (int k = 0; k < search_scene::keypoints; ++k) {
    cells.push_back({static_cast<int>(std::round(s.x[at(k)] * inv_x)),
                     static_cast<int>(std::round(s.y[at(k)] * inv_y))});
  }
  int matches = 0;
  taken.assign(windows.size(), -1);
  for (std::size_t i = 0; i < windows.size(); ++i) {
    told_window const& w = windows[i];
    if (w.slot < 0) { continue; }
    std::vector<std::array<int, 3>> area;  // in the order of the grid's cells
    for (int k = 0; k < search_scene::keypoints; ++k) {
      auto const [cx, cy] = cells[at(k)];
      if (cx > 63 || cy > 47) { continue; }
      int const o = s.octave[at(k)];
      if (o < w.low || (w.high >= 0 && o > w.high)) { continue; }
      if (std::fabs(s.x[at(k)] - w.x) < w.radius && std::fabs(s.y[at(k)] - w.y) < w.radius) {
        area.push_back({cx, cy, k});
      }
    }
    std::sort(area.begin(), area.end());
    int best = -1, best_distance = 256, best_octave = -1, second_distance = 256, second_octave = -1;
    for (auto const& a : area) {
      int const k = a[2];
      int const held = holder[at(k)];
      if (held >= 0 && s.observations[at(held)] > 0) { continue; }
      float const right = s.right_x[at(k)];
      if (right > 0 && std::fabs(w.right_x - right) > w.radius) { continue; }
      int const distance = s.bits;
      if (distance < best_distance) {
        second_distance = best_distance;
        second_octave = best_octave;
        best_distance = distance;
        best_octave = s.octave[at(k)];
        best = k;
      } else if (distance < second_distance) {
        second_distance = distance;
        second_octave = s.octave[at(k)];
      }
    }
    if (best < 0 || best_distance > 100) { continue; }
    if (ratio_test && best_octave == second_octave &&
        static_cast<float>(best_distance) > 0.8f * static_cast<float>(second_distance)) {
      continue;
    }
    holder[at(best)] = w.slot;
    taken[i] = best;
    ++matches;
  }
  return matches;
}

/// Section 10 of a rectified pair. @param ahead the way from the last frame, metres along its axis
search_answer search_last_plainly(search_scene const& s, ft::rectified_rig const& rig,
                                  ft::pyramid_geometry const& g, float ahead, int retry_below) {
  search_answer out;
  for (float th = 7; th < 20; th *= 2) {
    std::vector<told_window> windows;
    for (int i = 0; i < search_scene::keypoints; ++i) {
      told_window w{0, 0, 0, 0, 0, 0, -1};
      int const slot = s.last_holder[at(i)];
      if (slot >= 0) {
        auto const p = s.position[at(slot)];
        float const inv_z = 1 / p.z;
        w.x = rig.camera.fx * p.x / p.z + rig.camera.cx;
        w.y = rig.camera.fy * p.y / p.z + rig.camera.cy;
        w.right_x = w.x - rig.bf() * inv_z;
        int const o = s.last_octave[at(i)];
        w.radius = th * g.scale[o];
        bool const forward = ahead > rig.baseline;
        bool const backward = -ahead > rig.baseline;
        w.low = forward ? o : (backward ? 0 : o - 1);
        w.high = forward ? -1 : (backward ? o : o + 1);
        bool const seen = inv_z >= 0 && w.x >= 0 && w.x <= width && w.y >= 0 && w.y <= height;
        w.slot = seen ? slot : -1;
      }
      windows.push_back(w);
    }
    out.holder.assign(at(search_scene::keypoints), -1);
    std::vector<int> taken;
    out.matches = search_plainly(s, windows, false, out.holder, taken);
    std::array<int, 30> histogram{};
    std::vector<int> bin(windows.size(), -1);
    for (std::size_t i = 0; i < windows.size(); ++i) {
      if (taken[i] < 0) { continue; }
      float rotation = s.last_angle[i] - s.angle[at(taken[i])];
      if (rotation < 0) { rotation += 360; }
      bin[i] = static_cast<int>(std::round(rotation / 30)) % 30;
      ++histogram[at(bin[i])];
    }
    std::vector<int> order(30);
    for (int b = 0; b < 30; ++b) { order[at(b)] = b; }
    std::stable_sort(order.begin(), order.end(),
                     [&](int a, int b) { return histogram[at(a)] > histogram[at(b)]; });
    int kept = 1;
    auto const enough = [&](int rank) {
      return static_cast<float>(histogram[at(order[at(rank)])]) >=
             0.1f * static_cast<float>(histogram[at(order[0])]);
    };
    if (enough(1)) { kept = enough(2) ? 3 : 2; }
    for (std::size_t i = 0; i < windows.size(); ++i) {
      if (taken[i] < 0 ||
          std::find(order.begin(), order.begin() + kept, bin[i]) != order.begin() + kept) {
        continue;
      }
      out.holder[at(taken[i])] = -1;
      --out.matches;
    }
    if (out.matches >= retry_below) { break; }
  }
  return out;
}

/// Sections 8 and 9 of a rectified pair that stands at the origin.
search_answer search_local_plainly(search_scene const& s, ft::rectified_rig const& rig,
                                   ft::pyramid_geometry const& g, float th) {
  std::vector<told_window> windows;
  for (int const slot : s.slots) {
    told_window w{0, 0, 0, 0, 0, 0, -1};
    if (slot >= 0) {
      auto const p = s.position[at(slot)];
      float const distance = std::sqrt(ft::dot(p, p));
      float const cosine = ft::dot(p, s.normal[at(slot)]) / distance;
      w.x = rig.camera.fx * p.x / p.z + rig.camera.cx;
      w.y = rig.camera.fy * p.y / p.z + rig.camera.cy;
      w.right_x = w.x - rig.bf() / p.z;
      bool const seen = p.z >= 0 && w.x >= 0 && w.x <= width && w.y >= 0 && w.y <= height &&
                        distance >= 0.8f * s.min_distance[at(slot)] &&
                        distance <= 1.2f * s.max_distance[at(slot)] && cosine >= 0.5f;
      int const level =
          std::clamp(static_cast<int>(std::ceil(std::log(s.max_distance[at(slot)] / distance) /
                                                std::log(g.scale_factor))),
                     0, g.levels - 1);
      w.radius = (cosine >= 0.998f ? 2.5f : 4.0f) * th * g.scale[level];
      w.low = level - 1;
      w.high = level;
      w.slot = seen ? slot : -1;
    }
    windows.push_back(w);
  }
  search_answer out;
  out.holder = s.holder;
  std::vector<int> taken;
  out.matches = search_plainly(s, windows, true, out.holder, taken);
  return out;
}

/// Both searches by ft. @param retry_below of the last-frame search; below 0: the local map's
template <typename Exec>
search_answer search(Exec const& exec, search_scene const& s, ft::rectified_rig const& rig,
                     ft::pyramid_geometry const& g, float ahead, int retry_below, float th) {
  constexpr int n = search_scene::keypoints;
  constexpr int m = search_scene::points;
  ft::frame_view frame;
  ft::last_frame_view last;
  ft::map_points_view map;
  ft::search_buffers buffers;
  ft::pose* poses = nullptr;
  int* slots = nullptr;
  int* slot_count = nullptr;
  float* right_x = nullptr;
  int* last_holder = nullptr;
  auto const geometry = ft::grid_geometry::over(0, 0, width, height);
  ft::arena<Exec::space> const memory([&](ft::carver& c) {
    carve(c, frame.keypoints, n, 1);
    carve(c, frame.grids, geometry, n, 1);
    carve(c, last.keypoints, n, 1);
    carve(c, map, m, 1);
    carve(c, buffers.windows, n, 1, 1);
    carve(c, buffers.work, n, n, 1, 1);
    frame.holder = c.take<int>(n);
    last_holder = c.take<int>(n);
    right_x = c.take<float>(n);
    poses = c.take<ft::pose>(2);
    slots = c.take<int>(n);
    slot_count = c.take<int>(1);
  });
  frame.keypoint_step = last.keypoint_step = 1;
  frame.right_x = right_x;
  last.holder = last_holder;
  auto const put = [&](auto* to, auto const& values) {
    ft::copy(exec, to, values.data(), values.size());
    exec.wait();
  };
  ft::descriptor same{};
  for (auto& word : same.words) { word = 0x5a5a1234u; }
  ft::descriptor wanted = same;
  for (int b = 0; b < s.bits; ++b) { wanted.words[b / 32] ^= 1u << (b % 32); }
  std::vector<int> const counts{n};
  put(ft::array_of<ft::field::x>(frame.keypoints), s.x);
  put(ft::array_of<ft::field::y>(frame.keypoints), s.y);
  put(ft::array_of<ft::field::angle>(frame.keypoints), s.angle);
  put(ft::array_of<ft::field::octave>(frame.keypoints), s.octave);
  put(ft::array_of<ft::field::orb>(frame.keypoints), std::vector<ft::descriptor>(at(n), same));
  put(frame.keypoints.count, counts);
  put(frame.holder, s.holder);
  put(right_x, s.right_x);
  put(ft::array_of<ft::field::angle>(last.keypoints), s.last_angle);
  put(ft::array_of<ft::field::octave>(last.keypoints), s.last_octave);
  put(last.keypoints.count, counts);
  put(last_holder, s.last_holder);
  put(ft::array_of<ft::field::position>(map), s.position);
  put(ft::array_of<ft::field::normal>(map), s.normal);
  put(ft::array_of<ft::field::min_distance>(map), s.min_distance);
  put(ft::array_of<ft::field::max_distance>(map), s.max_distance);
  put(ft::array_of<ft::field::observations>(map), s.observations);
  put(ft::array_of<ft::field::orb>(map), std::vector<ft::descriptor>(at(m), wanted));
  put(slots, s.slots);
  put(slot_count, std::vector<int>{m});
  ft::pose last_pose = ft::pose::identity();
  last_pose.t.z = ahead;
  put(poses, std::vector<ft::pose>{ft::pose::identity(), last_pose});
  ft::build_grid<ft::nearest_cell>(exec, frame.keypoints, 0, 1, 1, frame.grids);
  if (retry_below >= 0) {
    ft::last_search<ft::rectified_rig> search;
    search.rig = rig;
    search.T_cw = poses;
    search.last_T_cw = poses + 1;
    search.last = last;
    search.geometry = g;
    search.params.retry_below = retry_below;
    search.params.max_x = width;
    search.params.max_y = height;
    ft::search_last_frame(exec, search, frame, map, buffers);
  } else {
    ft::local_search<ft::rectified_rig> local;
    local.rig = rig;
    local.T_cw = poses;
    local.slots = slots;
    local.slot_count = slot_count;
    local.frustum.max_x = width;
    local.frustum.max_y = height;
    local.frustum.log_scale_factor = ft::log_rounded(g.scale_factor);
    local.frustum.levels = g.levels;
    local.geometry = g;
    local.params.radius_factor = th;
    ft::search_local_map(exec, local, frame, map, buffers);
  }
  exec.wait();
  return {test::from_exec(exec, static_cast<int const*>(frame.holder), at(n)),
          test::from_exec(exec, static_cast<int const*>(buffers.work.matches), 1)[0]};
}

TYPED_TEST(bad_input_test, searches_with_equal_descriptors_take_what_the_rules_say) {
  auto const rig = a_rig<ft::rectified_rig>();
  auto const g = ft::pyramid_geometry::make(width, height, 6, 1.2f);
  int last_matches = 0;
  int local_matches = 0;
  for (unsigned seed = 0; seed < 6; ++seed) {
    for (int const bits : {0, 30, 100, 101}) {
      auto const scene = make_scene(seed, bits, rig, g);
      for (float const ahead : {0.0f, 0.5f, -0.5f}) {
        for (int const retry_below : {0, 1000}) {
          auto const want = search_last_plainly(scene, rig, g, ahead, retry_below);
          auto const got = search(this->exec(), scene, rig, g, ahead, retry_below, 1);
          EXPECT_EQ(got.holder, want.holder) << seed << ' ' << bits << ' ' << ahead;
          EXPECT_EQ(got.matches, want.matches) << seed << ' ' << bits << ' ' << ahead;
          if (bits > 100) { EXPECT_EQ(got.matches, 0); }
          last_matches += got.matches;
        }
      }
      for (float const th : {1.0f, 3.0f}) {
        auto const want = search_local_plainly(scene, rig, g, th);
        auto const got = search(this->exec(), scene, rig, g, 0, -1, th);
        EXPECT_EQ(got.holder, want.holder) << seed << ' ' << bits << ' ' << th;
        EXPECT_EQ(got.matches, want.matches) << seed << ' ' << bits << ' ' << th;
        local_matches += got.matches;
      }
    }
  }
  EXPECT_GT(last_matches, 2000);
  EXPECT_GT(local_matches, 500);
}

// ---- map points that no camera can see --------------------------------------------------------

/// Behind the cameras, in their centres, at infinity, nowhere; cameras as at the origin.
template <typename Rig>
std::vector<ft::vec3<float>> unseen_positions(Rig const& rig) {
  std::vector<ft::vec3<float>> all{
      {0, 0, 0},      {0, 0, -3},      {1, 1, -2},     {-5, 0.1f, -1e-3f},
      {inf, 0, 1},    {0, -inf, 1},    {0, 0, inf},    {0, 0, -inf},
      {inf, inf, 1},  {inf, inf, inf}, {nan, 0.1f, 3}, {0, nan, 3},
      {0.1f, 0, nan}, {nan, nan, nan}, {0, 0, -3e38f}, {3e38f, 0, -1}};
  if constexpr (Rig::rectified) {
    all.push_back({rig.baseline_length().value, 0, 0});
  } else {
    all.push_back(rig.T_rl.inverse().t);
  }
  return all;
}

TYPED_TEST(bad_input_test, map_points_that_cannot_be_seen_are_left_out_and_change_nothing) {
  using executor = typename TestFixture::exec_type;
  for_each_rig([&](auto rig) {
    using rig_type = decltype(rig);
    auto const frames = make_frames(rig);
    auto const where = unseen_positions(rig);
    constexpr int first_slot = 600;
    std::vector<snapshot> with[2];
    for (std::size_t bad = 0; bad < 2; ++bad) {
      driver<executor, rig_type> d(this->exec(), rig);
      auto const seen = d.first(frames[0]);
      ASSERT_GT(d.points.size(), 40u);
      std::vector<ft::point_update> updates;
      for (std::size_t i = 0; i < where.size(); ++i) {
        // An update with a NaN is refused; a slot that is never written has NaNs.
        if (std::isnan(where[i].x + where[i].y + where[i].z)) { continue; }
        auto const& like = d.points[i % d.points.size()];
        updates.push_back(
            {first_slot + static_cast<int>(i), 1, where[i], {0, 0, 1}, 0.0f, 1e30f, like.orb});
      }
      d.tracker.update_map(this->exec(), 0, updates.data(), static_cast<int>(updates.size()));
      this->exec().wait();
      auto const choose_local = [&] {
        int count = 0;
        for (std::size_t i = 0; i < d.points.size(); ++i) {
          if (bad == 1) {
            d.in.local_slots[at(count++)] = first_slot + static_cast<int>(i % where.size());
          }
          d.in.local_slots[at(count++)] = d.points[i].slot;
        }
        d.in.local_count[0] = count;
      };
      auto const keep = [&](bool local) {
        auto s = d.result(local);
        if (bad == 1 && local) {
          std::vector<unsigned char> good;
          for (std::size_t i = 0; i < s.in_view.size(); ++i) {
            if (i % 2 == 1) {
              good.push_back(s.in_view[i]);
            } else {
              EXPECT_EQ(s.in_view[i], 0) << "position " << i / 2 % where.size();
            }
          }
          s.in_view = good;
        }
        EXPECT_EQ(count_of<int>(s.holder, [](int h) { return h >= first_slot; }), 0);
        with[bad].push_back(s);
      };
      // From the last frame: keypoints without a depth hold these points.
      d.use_as_last(seen);
      int given = 0;
      for (int number = 0; bad == 1 && number < d.numbers(d.tracker); ++number) {
        auto const capacity = d.tracker.capacity();
        if (number % capacity < seen.keypoints[at(number / capacity)] &&
            d.in.last_holder[at(number)] < 0) {
          d.in.last_holder[at(number)] = first_slot + given++ % static_cast<int>(where.size());
        }
      }
      if (bad == 1) { EXPECT_GE(given, 20); }
      choose_local();
      d.images(frames[1].left, frames[1].right);
      d.in.track_motion(this->exec());
      keep(false);
      d.in.track_local(this->exec());
      keep(true);
      // In the local map, by cameras that stand exactly at the origin.
      d.extract(frames[0]);
      choose_local();
      d.in.relocalize(this->exec());
      keep(true);
    }
    ASSERT_EQ(with[0].size(), with[1].size());
    for (std::size_t i = 0; i < with[0].size(); ++i) {
      SCOPED_TRACE(i);
      expect_same(with[1][i], with[0][i]);
      EXPECT_GT(with[0][i].inliers, 50);
    }
  });
}

TYPED_TEST(bad_input_test, map_points_and_poses_with_a_nan_are_refused_and_change_nothing) {
  using executor = typename TestFixture::exec_type;
  auto const rig = a_rig<ft::rectified_rig>();
  auto const frames = make_frames(rig);
  std::vector<snapshot> of[2];
  for (bool const bad : {false, true}) {
    driver<executor, ft::rectified_rig> d(this->exec(), rig);
    auto const seen = d.first(frames[0]);
    d.use_as_last(seen);
    if (bad) {
      for (int k = 0; k < 8; ++k) {
        std::vector<ft::point_update> two{d.points[0], d.points[1]};
        auto& p = two[1];
        float* const lengths[] = {&p.position.x, &p.position.y, &p.position.z,   &p.normal.x,
                                  &p.normal.y,   &p.normal.z,   &p.min_distance, &p.max_distance};
        two[0].position.x += 1;
        *lengths[k] = nan;
        expect_says(refusal([&] { d.tracker.update_map(this->exec(), 0, two.data(), 2); }),
                    {"slot " + std::to_string(p.slot), "NaN"});
      }
      for (int k = 0; k < 12; ++k) {
        for (float const v : {nan, inf}) {
          ft::pose T = ft::pose::identity();
          (k < 9 ? T.R.m[k] : k == 9 ? T.t.x : k == 10 ? T.t.y : T.t.z) = v;
          auto const& exec = this->exec();
          auto& tracker = d.tracker;
          std::vector<std::string> const says{"predicted pose"};
          expect_says(refusal([&] { tracker.track_motion(exec, T); }), says);
          expect_says(refusal([&] { tracker.track(exec, {T, {}}); }), says);
          expect_says(refusal([&] { tracker.relocalize(exec, {T, {}}); }), says);
          expect_says(refusal([&] { tracker.set_last(exec, 0, T, d.in.last_holder); }),
                      {"last pose"});
        }
      }
    }
    d.images(frames[1].left, frames[1].right);
    d.in.track_motion(this->exec());
    of[bad ? 1 : 0].push_back(d.result(false));
    d.in.track_local(this->exec());
    of[bad ? 1 : 0].push_back(d.result(true));
  }
  EXPECT_GT(of[0][1].inliers, 50);
  for (std::size_t i = 0; i < 2; ++i) { expect_same(of[1][i], of[0][i]); }
}

TYPED_TEST(bad_input_test, a_frame_before_any_image_is_refused) {
  using executor = typename TestFixture::exec_type;
  auto const& exec = this->exec();
  auto const rig = a_rig<ft::rectified_rig>();
  auto const frame = make_frames(rig)[0];
  ft::frame_tracker<executor> tracker(exec, rig, params(), 2);
  std::vector<ft::frame_input> const inputs(2);
  std::vector<ft::pose> const predicted(2, ft::pose::identity());
  auto const refused = [&](std::string const& camera) {
    expect_says(refusal([&] { tracker.extract(exec); }), {camera});
    expect_says(refusal([&] { tracker.track_motion(exec, predicted.data()); }), {camera});
    expect_says(refusal([&] { tracker.track(exec, inputs.data()); }), {camera});
  };
  refused("camera 0 of pair 0");
  tracker.set_image(0, 0, view(frame.left));
  refused("camera 1 of pair 0");
  tracker.set_image(0, 1, view(frame.right));
  refused("camera 0 of pair 1");
  static_cast<void>(tracker.staged_image(1, 0));
  refused("camera 1 of pair 1");
  static_cast<void>(tracker.staged_image(1, 1));
  EXPECT_NO_THROW(tracker.track(exec, inputs.data()));
  exec.wait();
}

/// Points that the frame holds lose their positions before the search in the local map.
template <typename Exec, typename Rig>
void expect_released(Exec const& exec, Rig const& rig) {
  auto const frames = make_frames(rig);
  for (int const every : {1, 3}) {
    driver<Exec, Rig> d(exec, rig);
    d.first(frames[0]);
    d.images(frames[1].left, frames[1].right);
    d.in.track_motion(exec);
    auto const before = d.result(false);
    ASSERT_GT(before.inliers, 50);
    std::vector<ft::point_update> updates;
    for (std::size_t i = 0; i < d.points.size(); i += static_cast<std::size_t>(every)) {
      auto p = d.points[i];
      float const bad[] = {nan, inf, -inf};
      p.position = {p.position.x, bad[i % 3], i % 2 == 0 ? nan : p.position.z};
      updates.push_back(p);
      // Not by update_map(), which refuses them.
      ft::copy(exec, ft::array_of<ft::field::position>(d.tracker.map()) + p.slot,
               static_cast<ft::vec3<float> const*>(&p.position), 1);
      exec.wait();
    }
    d.in.track_local(exec);
    auto const after = d.result(true);
    for (auto const& u : updates) {
      EXPECT_EQ(std::count(after.holder.begin(), after.holder.end(), u.slot), 0);
    }
    EXPECT_EQ(after.inliers, held(after));
    if (every == 1) {
      EXPECT_EQ(after.inliers, 0);
      EXPECT_EQ(std::memcmp(&after.T_cw, &before.T_cw, sizeof(ft::pose)), 0);
    } else {
      EXPECT_GT(after.inliers, 30);
      auto const moved = after.T_cw.t - before.T_cw.t;
      EXPECT_LT(std::sqrt(ft::dot(moved, moved)), 0.02f);
    }
  }
}

TYPED_TEST(bad_input_test, a_held_point_that_becomes_no_number_is_released) {
  expect_released(this->exec(), a_rig<ft::rectified_rig>());
  expect_released(this->exec(), a_rig<kb_pair>());
}

// Pose optimisation does not look at whether a projection is valid: of these models a point without
// a number projects to the principal point, and a keypoint near it keeps the point.
TYPED_TEST(bad_input_test, a_held_point_that_becomes_no_number_is_released_of_any_model) {
  expect_released(this->exec(), a_rig<mixed_pair>());
  expect_released(this->exec(), a_rig<sphere_pair>());
}

}  // namespace bad_input

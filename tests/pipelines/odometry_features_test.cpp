// SPDX-License-Identifier: Apache-2.0
// Keypoints of the caller: those of ft's own extraction give its poses, and what is refused.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstring>
#include <limits>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "ft/cameras/monocular_rig.hpp"
#include "ft/cameras/radtan.hpp"
#include "ft/cameras/rgbd_rig.hpp"
#include "ft/pipelines/explain.hpp"
#include "ft/pipelines/odometry.hpp"
#include "tests/support/allocation_count.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/odometry_answers.hpp"
#include "tests/support/refusals.hpp"
#include "tests/support/room.hpp"
#include "tests/support/room_features.hpp"

namespace odometry_features_test {

using test::error_of;
using test::room::at;
using test::room::copy_of;
using test::room::features;
using test::room::pair_features;
using test::room::stereo_frame;
constexpr std::int64_t period = 50'000'000;
constexpr float nan = std::numeric_limits<float>::quiet_NaN();

std::int64_t time_of(std::size_t i) { return period * static_cast<std::int64_t>(i + 1); }

ft::odometry_params params(bool own_features = true) {
  auto p = test::room::odometry_params(4096);
  p.own_features = own_features;
  // Of near keypoints those of parts of the images that seem fixed to the camera are left out. That
  // needs images; so none is near. So does moving keypoints.
  p.rules.near_depth = 1;
  p.align_keypoints = false;
  return p;
}

std::vector<stereo_frame> const& walk() {
  static auto const frames = test::room::make_walk(test::room::rig(), 0, 16);
  return frames;
}

template <typename Exec>
std::vector<pair_features> extract(Exec const& exec, ft::rectified_rig const& rig,
                                   std::vector<stereo_frame> const& frames) {
  return test::room::extract(exec, rig, params().orb, frames);
}

template <typename Exec, typename Rig, typename FeaturesOf>
std::vector<ft::tracking> run(Exec const& exec, Rig const& rig, ft::odometry_params const& p,
                              std::size_t frames, FeaturesOf const& of) {
  ft::odometry<Exec, Rig> odo(exec, rig, p, 1, ft::own_features{});
  std::vector<ft::tracking> all;
  for (std::size_t i = 0; i < frames; ++i) { all.push_back(odo.track(of(i), time_of(i))); }
  return all;
}
template <typename Exec>
std::vector<ft::tracking> run_images(Exec const& exec, std::vector<stereo_frame> const& frames) {
  ft::odometry odo(exec, test::room::rig(), params(false));
  return test::track_all(odo, frames.size(), time_of(0),
                         [&](std::size_t i) { return images_of(frames[i]); });
}

/// All but what comes from images alone.
void expect_same_poses(std::vector<ft::tracking> const& given, std::vector<ft::tracking> images) {
  for (auto& t : images) {
    EXPECT_EQ(t.evidence.facts.fixed, 0);
    t.light = {};
  }
  EXPECT_EQ(given.front().light.image, -1);
  EXPECT_EQ(given.front().evidence.images, 0);
  EXPECT_GE(given.back().keyframes, 2);
  test::expect_same(given, images);
}

void expect_tracked(std::vector<ft::tracking> const& all, std::vector<stereo_frame> const& frames,
                    double most) {
  for (std::size_t i = 0; i < all.size(); ++i) {
    EXPECT_EQ(all[i].state, ft::tracking_state::tracking) << i;
    EXPECT_LT(error_of(all[i], frames[i], frames[0]), most) << i;
  }
}

template <typename Backend>
class odometry_features : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(odometry_features, test::backends);

TYPED_TEST(odometry_features, of_its_own_extraction_give_a_pair_the_poses_of_its_images) {
  TypeParam backend;
  // After 8 frames a part of the images that seemed fixed for so long is left out though far.
  for (unsigned seed = 0; seed < (test::whole_effort() ? 6u : 2u); ++seed) {
    SCOPED_TRACE("walk " + std::to_string(seed));
    auto const frames = test::room::make_walk(test::room::rig(), seed, 8);
    auto const given = extract(backend.exec, test::room::rig(), frames);
    expect_same_poses(run(backend.exec, test::room::rig(), params(), frames.size(),
                          [&](std::size_t i) { return given[i].with_partners(); }),
                      run_images(backend.exec, frames));
  }
}

TYPED_TEST(odometry_features, find_the_partners_of_a_pair_by_descriptors) {
  TypeParam backend;
  auto const given = extract(backend.exec, test::room::rig(), walk());
  auto const all = run(backend.exec, test::room::rig(), params(), walk().size(),
                       [&](std::size_t i) { return given[i].without_partners(); });
  expect_tracked(all, walk(), 0.03);
}

/// The arrays of features in executor memory.
template <typename Exec>
struct features_there {
  template <typename T>
  using array = ft::buffer<T, Exec::space>;
  array<float> positions, angle, score, right_x, depth;
  array<int> octave;
  array<ft::descriptor> descriptors;
  ft::image_features view;

  features_there(Exec const& exec, features const& of, ft::image_features const& given)
      : positions(test::to_exec(exec, of.positions)),
        angle(test::to_exec(exec, of.angle)),
        score(test::to_exec(exec, of.score)),
        right_x(test::to_exec(exec, of.right_x)),
        depth(test::to_exec(exec, of.depth)),
        octave(test::to_exec(exec, of.octave)),
        descriptors(test::to_exec(exec, of.descriptors)),
        view(given) {
    exec.wait();
    view.on_device = true;
    view.positions = positions.data();
    view.descriptors = descriptors.data();
    view.octave = octave.data();
    view.angle = angle.data();
    view.score = score.data();
    if (given.right_x != nullptr) { view.right_x = right_x.data(); }
    if (given.depth != nullptr) { view.depth = depth.data(); }
  }
};

// ---- a camera with depths, and one camera

template <typename Camera>
struct depth_frame {
  test::room::image gray;
  std::vector<float> depth;  ///< metres

  ft::rgbd_images images() const {
    return {test::room::view(gray),
            ft::image_view<float const>{depth.data(), test::room::width, test::room::height,
                                        test::room::width}};
  }
};
template <typename Camera>
std::vector<depth_frame<Camera>> depth_walk(Camera const& camera) {
  auto const walls = test::room::make_walls(0);
  std::vector<depth_frame<Camera>> all;
  for (auto const& step : walk()) {
    ft::pose const T_wc = step.T_cw.inverse();
    depth_frame<Camera> f{test::room::render(camera, walls, step.T_cw), {}};
    for (int v = 0; v < test::room::height; ++v) {
      for (int u = 0; u < test::room::width; ++u) {
        auto const p =
            test::room::look(camera, T_wc, static_cast<float>(u), static_cast<float>(v)).point;
        f.depth.push_back(static_cast<float>((step.T_cw.template cast<double>() * p).z));
      }
    }
    all.push_back(std::move(f));
    if (all.size() == 8) { break; }
  }
  return all;
}
template <typename Exec>
features extract_one(Exec const& exec, ft::orb_extractor<Exec>& extractor,
                     test::room::image const& image) {
  extractor.upload(exec, 0, test::room::view(image));
  extractor.extract(exec);
  return copy_of(extractor.download(exec).view());
}

template <typename Exec, typename Camera>
void depths_give_the_poses_of_images(Exec const& exec, ft::rgbd_rig<Camera> const& rig) {
  auto const frames = depth_walk(rig.camera);
  auto orb = params().orb;
  orb.exact_positions = orb.refine_positions = true;
  orb.corner_ratio = ft::odometry_corner_ratio;
  ft::orb_extractor<Exec> extractor(exec, orb, 1);
  ft::odometry<Exec, ft::rgbd_rig<Camera>> odo(exec, rig, params(false));
  std::vector<ft::tracking> want;
  std::vector<features> given;
  for (auto const& f : frames) {
    want.push_back(odo.track(f.images(), time_of(want.size())));
    given.push_back(extract_one(exec, extractor, f.gray));
    features& last = given.back();
    for (std::size_t i = 0; i < last.octave.size(); ++i) {
      auto const u = static_cast<int>(last.positions[2 * i]);
      auto const v = static_cast<int>(last.positions[2 * i + 1]);
      last.depth.push_back(f.depth[at(v) * at(test::room::width) + at(u)]);
    }
  }
  expect_same_poses(run(exec, rig, params(), frames.size(),
                        [&](std::size_t i) {
                          ft::given_features f{given[i].with_partners(), {}};
                          f.left.right_x = nullptr;
                          return f;
                        }),
                    want);
}

TYPED_TEST(odometry_features, of_its_own_extraction_give_a_camera_with_depths_the_same_poses) {
  TypeParam backend;
  depths_give_the_poses_of_images(backend.exec,
                                  ft::rgbd_rig<>::make(test::room::rig().camera, 0.25));
  depths_give_the_poses_of_images(
      backend.exec, ft::rgbd_rig<ft::radtan5<float>>::make(
                        {300, 301, 239.5f, 179.5f, {-0.2f, 0.05f, 5e-4f, -4e-4f, -0.005f}}, 0.25));
}

TYPED_TEST(odometry_features, of_its_own_extraction_give_one_camera_the_same_poses) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  using rig_type = ft::monocular_rig<ft::pinhole<float>>;
  auto const rig = rig_type::make(test::room::rig().camera);
  auto const frames = test::room::make_walk(test::room::rig(), 0, 20);
  auto p = params();
  p.orb.features = p.orb.start_features = 2500;  // as many in every frame
  auto orb = p.orb;
  orb.exact_positions = true;
  ft::orb_extractor<exec_type> extractor(backend.exec, orb, 1);
  std::vector<features> given;
  for (auto const& f : frames) { given.push_back(extract_one(backend.exec, extractor, f.left)); }
  auto without = p;
  without.own_features = false;
  ft::odometry<exec_type, rig_type> odo(backend.exec, rig, without);
  std::vector<ft::tracking> want;
  for (auto const& f : frames) {
    want.push_back(odo.track(test::room::view(f.left), time_of(want.size())));
  }
  expect_same_poses(run(backend.exec, rig, p, frames.size(),
                        [&](std::size_t i) {
                          return ft::given_features{given[i].view(), {}};
                        }),
                    want);
}

// ---- what is not given

/// Corner positions where the image has them.
features on_the_image(features of, ft::pyramid_geometry const& g) {
  for (std::size_t i = 0; i < of.octave.size(); ++i) {
    of.positions[2 * i] = g.column(of.positions[2 * i], of.octave[i]);
    of.positions[2 * i + 1] = g.row(of.positions[2 * i + 1], of.octave[i]);
    if (i < of.right_x.size() && of.right_x[i] >= 0) {
      of.right_x[i] = g.column(of.right_x[i], of.octave[i]);
    }
    if (i < of.depth.size()) { of.depth[i] = g.depth(of.depth[i], of.octave[i]); }
  }
  return of;
}
ft::pyramid_geometry exact_geometry() {
  auto const orb = params().orb;
  auto g = ft::pyramid_geometry::make(orb.width, orb.height, orb.levels, orb.scale_factor);
  g.exact = true;
  return g;
}

TYPED_TEST(odometry_features, may_have_positions_of_the_image_and_either_partner_or_depth) {
  TypeParam backend;
  auto const levels = extract(backend.exec, test::room::rig(), walk());
  std::vector<features> given;
  for (auto const& f : levels) { given.push_back(on_the_image(f.left, exact_geometry())); }
  auto const follow = [&](bool right_x, bool depth) {
    return run(backend.exec, test::room::rig(), params(), walk().size(), [&](std::size_t i) {
      ft::given_features f{given[i].with_partners(), {}};
      f.left.level_positions = false;
      if (!right_x) { f.left.right_x = nullptr; }
      if (!depth) { f.left.depth = nullptr; }
      return f;
    });
  };
  auto const want = run(backend.exec, test::room::rig(), params(), walk().size(),
                        [&](std::size_t i) { return levels[i].with_partners(); });
  for (auto const& all : {follow(true, true), follow(true, false), follow(false, true)}) {
    expect_tracked(all, walk(), 0.03);
    for (std::size_t i = 0; i < all.size(); ++i) {
      // The same keypoints and partners, up to rounding.
      EXPECT_EQ(all[i].stereo_points, want[i].stereo_points) << i;
      EXPECT_LT(10 * std::abs(all[i].inliers - want[i].inliers), want[i].inliers + 1) << i;
    }
  }
}

TYPED_TEST(odometry_features, may_lack_octave_angle_and_score) {
  TypeParam backend;
  auto const given = extract(backend.exec, test::room::rig(), walk());
  std::vector<features> zeros;
  for (auto const& f : given) {
    zeros.push_back(on_the_image(f.left, exact_geometry()));
    features& last = zeros.back();
    std::fill(last.octave.begin(), last.octave.end(), 0);
    std::fill(last.angle.begin(), last.angle.end(), 0.0f);
  }
  auto const with = [&](bool written) {
    return run(backend.exec, test::room::rig(), params(), walk().size(), [&](std::size_t i) {
      ft::given_features f{zeros[i].with_partners(), {}};
      f.left.level_positions = false;
      if (!written) { f.left.octave = nullptr; }
      if (!written) { f.left.angle = f.left.score = nullptr; }
      return f;
    });
  };
  auto const all = with(false);
  expect_tracked(all, walk(), 0.05);
  test::expect_same(all, with(true));
}

TYPED_TEST(odometry_features, may_have_deviations_instead_of_octaves) {
  TypeParam backend;
  auto const given = extract(backend.exec, test::room::rig(), walk());
  auto const g = exact_geometry();
  auto const follow = [&](float factor) {
    std::vector<std::vector<float>> deviations;
    for (auto const& f : given) {
      deviations.emplace_back();
      for (int const o : f.left.octave) { deviations.back().push_back(factor * g.scale[o]); }
    }
    return run(backend.exec, test::room::rig(), params(), walk().size(), [&](std::size_t i) {
      auto f = given[i].with_partners();
      f.left.octave = nullptr;
      f.left.deviation = deviations[i].data();
      return f;
    });
  };
  auto const want = run(backend.exec, test::room::rig(), params(), walk().size(),
                        [&](std::size_t i) { return given[i].with_partners(); });
  test::expect_same(follow(1.0f), want);
  test::expect_same(follow(1.09f), want);  // the ratio of two octaves is 1.2, 1.095 squared
  test::expect_same(follow(0.92f), want);
  EXPECT_FALSE(test::same(follow(1.11f)[5], want[5]));
}

TYPED_TEST(odometry_features, beyond_the_capacity_are_the_best_by_score_and_the_first_of_equals) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const given = extract(backend.exec, test::room::rig(), walk());
  ft::odometry<exec_type, ft::rectified_rig> odo(backend.exec, test::room::rig(), params(), 1,
                                                 ft::own_features{});
  int const capacity = odo.capacity();
  features many;
  for (std::size_t i = 0; many.octave.size() < at(4 * capacity); ++i) {
    features const& f = given[i].left;
    many.positions.insert(many.positions.end(), f.positions.begin(), f.positions.end());
    many.octave.insert(many.octave.end(), f.octave.begin(), f.octave.end());
    many.descriptors.insert(many.descriptors.end(), f.descriptors.begin(), f.descriptors.end());
  }
  auto const n = many.octave.size();
  std::uint32_t state = 7;
  for (std::size_t i = 0; i < n; ++i) {
    state = state * 1664525u + 1013904223u;
    many.score.push_back(static_cast<float>(state >> 28));  // 16 scores: many are equal
    many.angle.push_back(0);
  }
  auto const kept = [&](bool scored) {
    std::vector<std::size_t> order(n);
    for (std::size_t i = 0; i < n; ++i) { order[i] = i; }
    if (scored) {
      std::stable_sort(order.begin(), order.end(),
                       [&](std::size_t a, std::size_t b) { return many.score[a] > many.score[b]; });
    }
    order.resize(at(capacity));
    std::sort(order.begin(), order.end());
    return order;
  };
  many.score[0] = -0.0f;
  features_there<exec_type> const moved(backend.exec, many, many.view());
  std::int64_t time = 0;
  for (bool const scored : {true, false}) {
    for (bool const on_device : {false, true}) {
      ft::given_features f{on_device ? moved.view : many.view(), {}};
      if (!scored) { f.left.score = nullptr; }
      auto const t = odo.track(f, time += period);
      EXPECT_EQ(t.keypoints, capacity);
      auto const& r = odo.keypoints();
      ASSERT_EQ(r.keypoints[0], capacity);
      auto const want = kept(scored);
      for (std::size_t k = 0; k < want.size(); ++k) {
        ASSERT_EQ(r.x[k], many.positions[2 * want[k]]) << k;
        ASSERT_EQ(r.y[k], many.positions[2 * want[k] + 1]) << k;
        ASSERT_EQ(r.octave[k], many.octave[want[k]]) << k;
      }
    }
  }
}

TYPED_TEST(odometry_features, in_executor_memory_are_those_in_host_memory) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  using there = features_there<exec_type>;
  auto const given = extract(backend.exec, test::room::rig(), {walk().begin(), walk().begin() + 4});
  for (bool const partners : {false, true}) {
    std::vector<std::unique_ptr<there>> kept;
    auto const of = [&](std::size_t i) {
      ft::given_features f = partners ? given[i].with_partners() : given[i].without_partners();
      if (i == 1) { return f; }  // both kinds mix
      auto const move = [&](features const& from, ft::image_features& view) {
        kept.push_back(std::make_unique<there>(backend.exec, from, view));
        view = kept.back()->view;
      };
      move(given[i].left, f.left);
      if (!partners) { move(given[i].right, f.right); }
      return f;
    };
    test::expect_same(
        run(backend.exec, test::room::rig(), params(), given.size(), of),
        run(backend.exec, test::room::rig(), params(), given.size(), [&](std::size_t i) {
          return partners ? given[i].with_partners() : given[i].without_partners();
        }));
  }
}

TYPED_TEST(odometry_features, in_executor_memory_are_left_out_where_numbers_are_out_of_range) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto all = extract(backend.exec, test::room::rig(), {walk()[0]})[0].left;
  features const good = all;
  all.positions[2 * 3] = nan;
  all.positions[2 * 5 + 1] = static_cast<float>(test::room::height);
  all.octave[7] = -1;
  all.angle[9] = 361;
  all.score[11] = -std::numeric_limits<float>::infinity();
  all.depth[13] = 2e10f;
  features_there<exec_type> const moved(backend.exec, all, all.with_partners());
  ft::odometry<exec_type, ft::rectified_rig> odo(backend.exec, test::room::rig(), params(), 1,
                                                 ft::own_features{});
  int const n = static_cast<int>(good.octave.size());
  EXPECT_EQ(odo.track({moved.view, {}}, time_of(0)).keypoints, n - 6);
  std::size_t k = 0;
  for (int const i : {0, 1, 2, 4, 6, 8, 10, 12, 14, 15}) {
    EXPECT_EQ(odo.keypoints().octave[k++], good.octave[at(i)]) << i;
  }
  ft::given_features f{moved.view, {}};
  f.left.descriptors = static_cast<unsigned char const*>(f.left.descriptors) + 1;
  EXPECT_THROW(odo.track(f, time_of(1)), ft::bad_argument) << "alignment";
}

TYPED_TEST(odometry_features, partners_that_are_none_have_no_depth) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto given = extract(backend.exec, test::room::rig(), {walk()[0]})[0].left;
  given.positions[0] = 1e-12f;
  ft::odometry<exec_type, ft::rectified_rig> odo(backend.exec, test::room::rig(), params(), 1,
                                                 ft::own_features{});
  float const inf = std::numeric_limits<float>::infinity();
  auto const n = given.octave.size();
  std::vector<float> right(n), depth(n);
  for (std::size_t i = 0; i < n; ++i) {
    float const x = given.positions[2 * i];
    float const rights[] = {nan, -1.0f, x, x + 1, inf, x - 5};
    float const depths[] = {nan, -1.0f, 0, inf, 2, 3};
    right[i] = rights[i % 6];
    depth[i] = depths[i % 6];
  }
  right[0] = 0;  // the depth would be 7e13 m
  ft::given_features f{given.view(), {}};
  f.left.right_x = right.data();
  odo.track(f, time_of(0));
  float const bf = test::room::rig().bf();
  for (std::size_t i = 0; i < n; ++i) {
    float const x = given.positions[2 * i];
    EXPECT_EQ(odo.keypoints().depth[i], i % 6 == 5 ? bf / (x - (x - 5)) : -1.0f) << i;
  }
  f.left.right_x = nullptr;
  f.left.depth = depth.data();
  odo.track(f, time_of(1));
  for (std::size_t i = 0; i < n; ++i) {
    EXPECT_EQ(odo.keypoints().depth[i], i % 6 == 4 ? 2.0f : i % 6 == 5 ? 3.0f : -1.0f) << i;
  }
}

// ---- what is refused

TYPED_TEST(odometry_features, refuses_what_it_cannot_take_and_goes_on) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const given = extract(backend.exec, test::room::rig(), {walk().begin(), walk().begin() + 3});
  ft::odometry<exec_type, ft::rectified_rig> odo(backend.exec, test::room::rig(), params(), 1,
                                                 ft::own_features{});
  auto const refused = [&](char const* word, auto const& change) {
    auto copy = given[1];
    ft::given_features f = copy.without_partners();
    change(f, copy);
    test::expect_refused([&] { odo.track(f, time_of(1)); }, word);
  };
  using given_type = ft::given_features;
  std::vector<ft::tracking> all{odo.track(given[0].without_partners(), time_of(0))};
  float const inf = std::numeric_limits<float>::infinity();
  for (float const v : {nan, inf, -inf, -0.5f, static_cast<float>(test::room::width)}) {
    refused("position 3", [&](given_type&, pair_features& c) { c.left.positions[6] = v; });
    refused("right image", [&](given_type&, pair_features& c) { c.right.positions[0] = v; });
  }
  refused("position 3", [&](given_type&, pair_features& c) {
    c.left.positions[7] = static_cast<float>(test::room::height);
  });
  refused("octave 2 is 8", [&](given_type&, pair_features& c) { c.left.octave[2] = 8; });
  refused("octave 2 is -1", [&](given_type&, pair_features& c) { c.left.octave[2] = -1; });
  refused("angle 4", [&](given_type&, pair_features& c) { c.left.angle[4] = -1; });
  refused("angle 4", [&](given_type&, pair_features& c) { c.left.angle[4] = nan; });
  refused("score 4", [&](given_type&, pair_features& c) { c.left.score[4] = nan; });
  refused("count is -1", [&](given_type& f, pair_features&) { f.left.count = -1; });
  refused("positions is null", [&](given_type& f, pair_features&) { f.left.positions = nullptr; });
  refused("descriptors is null",
          [&](given_type& f, pair_features&) { f.right.descriptors = nullptr; });
  refused("descriptor_bytes is 64",
          [&](given_type& f, pair_features&) { f.left.descriptor_bytes = 64; });
  refused("octave and deviation",
          [&](given_type& f, pair_features& c) { f.left.deviation = c.left.score.data(); });
  std::vector<float> const none(given[1].left.octave.size(), 0.0f);
  refused("deviation 0 is 0", [&](given_type& f, pair_features&) {
    f.left.octave = nullptr;
    f.left.deviation = none.data();
  });
  for (float const z : {1e10f, 1e15f, 3e38f}) {
    refused("depth 5 is ", [&](given_type& f, pair_features& c) {
      c.left.depth[5] = z;
      f.left.depth = c.left.depth.data();
    });
  }
  refused("belong to the left image",
          [&](given_type& f, pair_features&) { f.right.depth = none.data(); });
  EXPECT_THROW(odo.track(given[1].without_partners(), time_of(0)), ft::bad_argument) << "a time";
  all.push_back(odo.track(given[1].without_partners(), time_of(1)));
  all.push_back(odo.track(given[2].without_partners(), time_of(2)));
  test::expect_same(all, run(backend.exec, test::room::rig(), params(), 3,
                             [&](std::size_t i) { return given[i].without_partners(); }));
}

TYPED_TEST(odometry_features, need_their_part_and_a_rig_that_takes_them) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const given = extract(backend.exec, test::room::rig(), {walk()[0]})[0];
  EXPECT_THROW(
      (ft::odometry<exec_type, ft::rectified_rig>(backend.exec, test::room::rig(), params())),
      ft::bad_argument);
  ft::odometry<exec_type, ft::rectified_rig> without(backend.exec, test::room::rig(), params(false),
                                                     1, ft::own_features{});
  EXPECT_THROW(without.track(given.without_partners(), time_of(0)), ft::bad_argument);
  EXPECT_THROW((ft::odometry<exec_type, test::room::fisheye_rig>(
                   backend.exec, test::room::fisheye(), params(), 1, ft::own_features{})),
               ft::bad_argument);

  ft::odometry<exec_type, ft::rgbd_rig<>> rgbd(backend.exec,
                                               ft::rgbd_rig<>::make(test::room::rig().camera, 0.25),
                                               params(), 1, ft::own_features{});
  EXPECT_THROW(rgbd.track({given.left.view(), {}}, time_of(0)), ft::bad_argument) << "no depth";
  EXPECT_THROW(rgbd.track(given.with_partners(), time_of(0)), ft::bad_argument) << "right_x";
  EXPECT_THROW(rgbd.track(given.without_partners(), time_of(0)), ft::bad_argument) << "right image";
  using one_type = ft::monocular_rig<ft::pinhole<float>>;
  ft::odometry<exec_type, one_type> one(backend.exec, one_type::make(test::room::rig().camera),
                                        params(), 1, ft::own_features{});
  ft::given_features depths{given.left.with_partners(), {}};
  EXPECT_THROW(one.track(depths, time_of(0)), ft::bad_argument);
  depths.left.right_x = nullptr;
  EXPECT_THROW(one.track(depths, time_of(0)), ft::bad_argument);
}

TYPED_TEST(odometry_features, say_what_they_lack) {
  TypeParam backend;
  auto const given = extract(backend.exec, test::room::rig(), {walk()[0]})[0];
  ft::odometry<typename TypeParam::exec_type, ft::rectified_rig> odo(
      backend.exec, test::room::rig(), params(), 1, ft::own_features{});
  auto const reason = [&](int n, std::size_t time) {
    ft::given_features f = given.without_partners();
    f.left.count = n;
    f.right.count = 0;
    return ft::explain(odo.track(f, time_of(time)), odo.params().rules);
  };
  EXPECT_EQ(reason(0, 0).reason, ft::tracking_reason::not_started);
  EXPECT_EQ(reason(10, 1).reason, ft::tracking_reason::blurred);
  EXPECT_NE(reason(10, 2).text.find("only 10 keypoints were given"), std::string::npos);
  EXPECT_EQ(reason(400, 3).reason, ft::tracking_reason::stereo_inconsistent);
}

// ---- beside other calls

TYPED_TEST(odometry_features, mix_with_images_and_frames_that_were_given_ahead) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  auto const given = extract(backend.exec, test::room::rig(), walk());
  auto p = params();
  p.prefetch = 2;
  ft::odometry<exec_type, ft::rectified_rig> odo(backend.exec, test::room::rig(), p, 1,
                                                 ft::own_features{});
  auto const images = [&](std::size_t i) {
    return ft::stereo_images{test::room::view(walk()[i].left), test::room::view(walk()[i].right)};
  };
  std::vector<ft::tracking> all;
  for (std::size_t i = 0; i < walk().size(); ++i) {
    if (i % 3 == 0) {
      odo.prefetch(images(i));  // forgotten
      all.push_back(odo.track(given[i].with_partners(), time_of(i)));
    } else if (i % 3 == 1) {
      all.push_back(odo.track(images(i), time_of(i)));
    } else {
      odo.prefetch(images(i));
      all.push_back(odo.track_prefetched(time_of(i)));
    }
  }
  auto want = run(backend.exec, test::room::rig(), params(), walk().size(),
                  [&](std::size_t i) { return given[i].with_partners(); });
  for (std::size_t i = 0; i < all.size(); ++i) { all[i].light = want[i].light; }
  test::expect_same(all, want);
}

TYPED_TEST(odometry_features, of_a_batch_are_those_of_each_rig) {
  TypeParam backend;
  auto const given = extract(backend.exec, test::room::rig(), walk());
  auto p = params();
  p.use_graphs = false;
  p.measure_stages = true;
  ft::odometry odo(backend.exec, test::room::rig(), p, 2, ft::own_features{});
  std::vector<ft::tracking> first, second;
  for (std::size_t i = 0; i < 5; ++i) {
    // One finds its partners, the other one is given them.
    ft::given_features const f[] = {given[i].without_partners(), given[5 - i].with_partners()};
    std::int64_t const times[] = {time_of(i), time_of(i)};
    ft::tracking const* const t = odo.track(f, times);
    first.push_back(t[0]);
    second.push_back(t[1]);
  }
  EXPECT_THROW(odo.track(given[0].with_partners(), time_of(9)), ft::bad_argument);
  EXPECT_FALSE(odo.stage_times().empty());
  test::expect_same(first, run(backend.exec, test::room::rig(), params(), 5,
                               [&](std::size_t i) { return given[i].without_partners(); }));
  test::expect_same(second, run(backend.exec, test::room::rig(), params(), 5,
                                [&](std::size_t i) { return given[5 - i].with_partners(); }));
}

#if !defined(__CUDACC__)

TEST(OdometryFeaturesOnTheHost, AllocatesNothingInAFrame) {
  auto const given = extract(ft::host_exec(2), test::room::rig(), walk());
  ft::odometry odo(ft::host_exec(2), test::room::rig(), params(), 1, ft::own_features{});
  odo.track(given[0].without_partners(), time_of(0));
  test::allocation_count const allocations;
  auto const one = std::make_unique<int>(1);
  if (allocations.so_far() == 0) { GTEST_SKIP() << "this program does not count allocations"; }
  for (std::size_t i = 1; i < 6; ++i) { odo.track(given[i].without_partners(), time_of(i)); }
  EXPECT_EQ(allocations.so_far(), *one);
}

TEST(OdometryFeaturesOnTheHost, TakesNoMemoryWithoutThem) {
  ft::odometry const with(ft::host_exec(1), test::room::rig(), params(), 1, ft::own_features{});
  ft::odometry const idle(ft::host_exec(1), test::room::rig(), params(false), 1,
                          ft::own_features{});
  ft::odometry const without(ft::host_exec(1), test::room::rig(), params(false));
  EXPECT_EQ(idle.memory_bytes().executor, without.memory_bytes().executor);
  EXPECT_EQ(idle.memory_bytes().staging, without.memory_bytes().staging);
  EXPECT_GT(with.memory_bytes().executor, without.memory_bytes().executor);
  EXPECT_GT(with.memory_bytes().staging, without.memory_bytes().staging);
}

#else

TEST(OdometryFeaturesParity, HostAndDeviceGiveTheSameBits) {
  if (!test::cuda_backend::available()) { GTEST_SKIP() << "no CUDA device"; }
  test::cuda_backend backend;
  auto const given = extract(ft::host_exec(), test::room::rig(), walk());
  std::vector<features> of_image;
  for (auto const& f : given) { of_image.push_back(on_the_image(f.left, exact_geometry())); }
  auto const both = [&](auto const& rig, auto const& of) {
    test::expect_same(run(backend.exec, rig, params(), walk().size(), of),
                      run(ft::host_exec(), rig, params(), walk().size(), of));
  };
  both(test::room::rig(), [&](std::size_t i) { return given[i].without_partners(); });
  both(test::room::rig(), [&](std::size_t i) {
    ft::given_features f{of_image[i].with_partners(), {}};
    f.left.level_positions = false;
    f.left.depth = nullptr;
    return f;
  });
  both(ft::rgbd_rig<>::make(test::room::rig().camera, 0.25), [&](std::size_t i) {
    ft::given_features f{of_image[i].with_partners(), {}};
    f.left.level_positions = false;
    f.left.right_x = nullptr;
    return f;
  });
}

#endif

}  // namespace odometry_features_test

// SPDX-License-Identifier: Apache-2.0
// Distorted images end to end: a grey and a depth image of a camera with radial-tangential
// distortion become keypoints, stereo matches of a virtual pair, map points and a pose; two
// distorted cameras become a rectified pair in front of the extractor. What
// docs/guide.md shows is taken from here.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "ft/stages.hpp"
#include "tests/support/backends.hpp"
#include "tests/support/random.hpp"

namespace rgbd_pipeline {

using test::at;

constexpr int width = 400;
constexpr int height = 300;

// ---- the scene --------------------------------------------------------------------------------

using camera_type = ft::radtan5<float>;

camera_type distorted() {
  return {262.0f, 261.0f, 203.0f, 147.0f, {-0.28f, 0.09f, 6e-4f, -4e-4f, -0.015f}};
}

/// A textured plane n . p = 2.5 with n = (0.25, 0.15, 1), world coordinates in metres.
struct plane {
  static constexpr int side = 500;
  std::vector<std::uint8_t> texture = test::random_image(side, side, 21);

  static double distance(ft::vec3<double> p) {
    return (0.25 * p.x + 0.15 * p.y + p.z - 2.5) / std::sqrt(0.25 * 0.25 + 0.15 * 0.15 + 1);
  }
  double grey(ft::vec3<double> p) const {
    double const s = (p.x + 50) * 75;
    double const t = (p.y + 50) * 75;
    int const x = static_cast<int>(s);
    int const y = static_cast<int>(t);
    auto const texel = [&](int i, int j) {
      return static_cast<double>(texture[at((j % side) * side + i % side)]);
    };
    double const fx = s - x;
    double const fy = t - y;
    return (1 - fx) * (1 - fy) * texel(x, y) + fx * (1 - fy) * texel(x + 1, y) +
           (1 - fx) * fy * texel(x, y + 1) + fx * fy * texel(x + 1, y + 1);
  }
};

struct picture {
  std::vector<std::uint8_t> grey;
  std::vector<std::uint16_t> depth;  ///< 1 / 5000 m along the axis
};

template <typename Camera>
picture render(plane const& world, Camera const& camera, ft::pose const& T_cw) {
  auto const wide = camera.template cast<double>();
  auto const T_wc = T_cw.cast<double>().inverse();
  picture out{std::vector<std::uint8_t>(at(width * height)),
              std::vector<std::uint16_t>(at(width * height))};
  for (int v = 0; v < height; ++v) {
    for (int u = 0; u < width; ++u) {
      auto const ray = wide.unproject({static_cast<double>(u), static_cast<double>(v)});
      EXPECT_TRUE(ray.valid);
      auto const d = T_wc.R * ray.direction;
      double const t =
          (2.5 - (0.25 * T_wc.t.x + 0.15 * T_wc.t.y + T_wc.t.z)) / (0.25 * d.x + 0.15 * d.y + d.z);
      double const grey = world.grey({T_wc.t.x + t * d.x, T_wc.t.y + t * d.y, T_wc.t.z + t * d.z});
      out.grey[at(v * width + u)] = static_cast<std::uint8_t>(std::lround(grey));
      out.depth[at(v * width + u)] =
          static_cast<std::uint16_t>(std::lround(5000 * t * ray.direction.z));
    }
  }
  return out;
}

ft::pose moved(float pitch, float yaw, ft::vec3<float> centre) {
  float const c = std::cos(yaw), s = std::sin(yaw), cp = std::cos(pitch), sp = std::sin(pitch);
  ft::mat3<float> const about_y{{c, 0, s, 0, 1, 0, -s, 0, c}};
  ft::mat3<float> const about_x{{1, 0, 0, 0, cp, -sp, 0, sp, cp}};
  return ft::pose{about_y * about_x, centre}.inverse();
}
/// Distance of two cameras' centres, metres, and the angle between them, rad.
struct difference {
  float metres, radians;
};
difference between(ft::pose const& a, ft::pose const& b) {
  auto const centre = a.centre() - b.centre();
  auto const R = a.R * b.R.transposed();
  return {std::sqrt(ft::dot(centre, centre)),
          0.5f * std::hypot(std::hypot(R.m[7] - R.m[5], R.m[2] - R.m[6]), R.m[3] - R.m[1])};
}

ft::gray_view view(std::vector<std::uint8_t> const& grey) {
  return {grey.data(), width, height, width};
}
ft::orb_params orb() {
  ft::orb_params p;
  p.width = width;
  p.height = height;
  p.features = 600;
  return p;
}

// ---- RGB-D ------------------------------------------------------------------------------------

/// Tracking with a grey and a depth image per frame: ft's stages on memory taken once.
template <typename Exec>
class rgbd_frontend {
public:
  static constexpr int map_slots = 2000;

  rgbd_frontend(Exec const& e, camera_type const& raw, ft::rectified_rig const& undistorted)
      : exec_(e),
        raw_(raw),
        rig_(undistorted),
        bounds_(ft::undistorted_bounds(raw, undistorted.camera, width, height)),
        orb_(e, orb(), 1) {
    int const n = orb_.capacity();
    auto const cells =
        ft::grid_geometry::over(bounds_.min_x, bounds_.min_y, bounds_.max_x, bounds_.max_y);
    arena_ = ft::arena<Exec::space>([&](ft::carver& c) {
      carve(c, undistorted_, n, 1);
      carve(c, matches_, n, 1);
      carve(c, frame_.grids, cells, n, 1);
      carve(c, last_keypoints_, n, 1);
      carve(c, map_, map_slots, 1);
      carve(c, buffers_.windows, n, 1, 1);
      carve(c, buffers_.work, n, n, 1, 1);
      carve(c, observations_, n, 1);
      frame_.holder = c.template take<int>(at(n));
      last_holder_ = c.template take<int>(at(n));
      poses_ = c.template take<ft::pose>(2);
      slots_ = c.template take<int>(at(n));
      slot_count_ = c.template take<int>(1);
      depth_ = c.template take<std::uint16_t>(at(width * height));
    });
    frame_.keypoints = ft::with_columns(orb_.keypoints(), undistorted_);
    frame_.keypoint_step = 1;  // one image a frame
    frame_.right_x = ft::array_of<ft::field::right_x>(matches_);
    last_.keypoints = last_keypoints_;
    last_.keypoint_step = 1;
    last_.holder = last_holder_;
  }

  /// Keypoints, their undistorted places, depths, grid.
  void see(picture const& p) {
    orb_.upload(exec_, 0, view(p.grey));
    ft::copy(exec_, depth_, p.depth.data(), p.depth.size());
    orb_.extract(exec_);
    ft::undistort_keypoints(exec_, raw_, rig_.camera, orb_.keypoints(), {undistorted_, nullptr});
    ft::depth_params depth;
    depth.bf = rig_.bf();
    depth.scale = 1.0f / 5000;
    ft::depth_images_view<std::uint16_t> const images{depth_, width, height, 2 * width, 0, 1};
    ft::associate_depth(exec_, orb_.keypoints(), undistorted_, images, depth, matches_);
    ft::build_grid<ft::nearest_cell>(exec_, frame_.keypoints, 0, 1, 1, frame_.grids);
  }
  /// The frame becomes the last one, `holder[k]` the slot that its keypoint k holds.
  void remember(std::vector<int> const& holder) {
    auto const n = at(orb_.capacity());
    auto const kp = frame_.keypoints;
    ft::copy(exec_, ft::array_of<ft::field::angle>(last_keypoints_),
             static_cast<float const*>(ft::array_of<ft::field::angle>(kp)), n);
    ft::copy(exec_, ft::array_of<ft::field::octave>(last_keypoints_),
             static_cast<int const*>(ft::array_of<ft::field::octave>(kp)), n);
    ft::copy(exec_, last_keypoints_.count, static_cast<int const*>(kp.count), 1);
    ft::copy(exec_, last_holder_, holder.data(), holder.size());
    exec_.wait();
  }
  /// Search from the last frame, and the pose. @return keypoints that were given a point
  int track_motion(ft::pose const& predicted, ft::pose const& last) {
    std::vector<ft::pose> const poses{predicted, last};
    ft::copy(exec_, poses_, poses.data(), 2);
    ft::last_search<ft::rectified_rig> search;
    search.rig = rig_;
    search.T_cw = poses_;
    search.last_T_cw = poses_ + 1;
    search.last = last_;
    search.geometry = orb_.geometry();
    search.params.window_radius = 15;
    search.params.min_x = bounds_.min_x;
    search.params.min_y = bounds_.min_y;
    search.params.max_x = bounds_.max_x;
    search.params.max_y = bounds_.max_y;
    search.params.retry_below = 20;
    ft::search_last_frame(exec_, search, frame_, map_, buffers_);
    optimize();
    exec_.wait();
    return test::from_exec(exec_, static_cast<int const*>(buffers_.work.matches), 1)[0];
  }
  /// Search for more points, and the pose. @return likewise
  int track_local(std::vector<int> const& slots, ft::pose const* start = nullptr) {
    auto const count = static_cast<int>(slots.size());
    ft::copy(exec_, slots_, slots.data(), slots.size());
    ft::copy(exec_, slot_count_, &count, 1);
    if (start != nullptr) { ft::copy(exec_, poses_, start, 1); }
    ft::local_search<ft::rectified_rig> local;
    local.rig = rig_;
    local.T_cw = poses_;
    local.slots = slots_;
    local.slot_count = slot_count_;
    local.frustum = {bounds_.min_x, bounds_.min_y, bounds_.max_x, bounds_.max_y};
    local.frustum.log_scale_factor = ft::log_rounded(orb_.params().scale_factor);
    local.frustum.levels = orb_.params().levels;
    local.geometry = orb_.geometry();
    local.params.radius_factor = 3;
    ft::find_visible_points(exec_, local, map_, buffers_.windows);
    ft::search_by_projection(exec_, frame_, map_, ft::search_params{}, buffers_);
    optimize();
    exec_.wait();
    return test::from_exec(exec_, static_cast<int const*>(buffers_.work.matches), 1)[0];
  }
  void forget() { ft::clear_holders(exec_, frame_); }

  ft::pose pose() const {
    return test::from_exec(exec_, static_cast<ft::pose const*>(poses_), 1)[0];
  }
  int inliers() const {
    return test::from_exec(exec_, static_cast<int const*>(observations_.inliers), 1)[0];
  }
  std::vector<int> holder() const {
    return test::from_exec(exec_, static_cast<int const*>(frame_.holder), at(orb_.capacity()));
  }
  ft::frame_view const& frame() const { return frame_; }
  ft::orb_extractor<Exec> const& extractor() const { return orb_; }
  ft::stereo_matches_view matches() const { return matches_; }
  ft::map_points_view map() const { return map_; }
  ft::image_bounds bounds() const { return bounds_; }

private:
  void optimize() {
    ft::optimize_frame_poses(exec_, rig_, {frame_, map_, orb_.geometry()},
                             {poses_, poses_, observations_});
  }

  Exec exec_;
  camera_type raw_;
  ft::rectified_rig rig_;
  ft::image_bounds bounds_;
  ft::orb_extractor<Exec> orb_;
  ft::pixels_view undistorted_;
  ft::stereo_matches_view matches_;
  ft::frame_view frame_;
  ft::soa_view<ft::field::angle, ft::field::octave> last_keypoints_;
  ft::last_frame_view last_;
  ft::map_points_view map_;
  ft::search_buffers buffers_;
  ft::observations_view observations_;
  int* last_holder_ = nullptr;
  ft::pose* poses_ = nullptr;
  int* slots_ = nullptr;
  int* slot_count_ = nullptr;
  std::uint16_t* depth_ = nullptr;
  ft::arena<Exec::space> arena_;
};

template <typename Backend>
class rgbd_test : public test::on_backend<Backend> {
protected:
  Backend backend;
};
TYPED_TEST_SUITE(rgbd_test, test::backends);

TYPED_TEST(rgbd_test, a_known_motion_is_found_from_distorted_images_and_their_depth) {
  using executor = typename TypeParam::exec_type;
  auto const& exec = this->backend.exec;
  plane const world;
  auto const raw = distorted();
  // The camera wanted: the same without distortion; a virtual pair 0.1 m apart.
  auto const rig = ft::rectified_rig::make({raw.fx, raw.fy, raw.cx, raw.cy}, 0.1f);
  ft::pose const T_first = ft::pose::identity();
  ft::pose const T_second = moved(0.02f, -0.015f, {0.05f, -0.03f, 0.06f});
  auto const second = render(world, raw, T_second);

  rgbd_frontend<executor> frontend(exec, raw, rig);
  EXPECT_LT(frontend.bounds().min_x, -5.0f) << "barrel distortion: more than the image";
  EXPECT_GT(frontend.bounds().max_x, width + 5.0f);

  // ---- the first frame makes the map
  frontend.see(render(world, raw, T_first));
  exec.wait();
  auto const kp = frontend.frame().keypoints;
  int const count = test::from_exec(exec, static_cast<int const*>(kp.count), 1)[0];
  auto const x = test::column<ft::field::x>(exec, kp);
  auto const y = test::column<ft::field::y>(exec, kp);
  auto const octave = test::column<ft::field::octave>(exec, kp);
  auto const descriptors = test::column<ft::field::orb>(exec, kp);
  auto const depth = test::column<ft::field::depth>(exec, frontend.matches());
  auto const right_x = test::column<ft::field::right_x>(exec, frontend.matches());
  ASSERT_GT(count, 500);
  ft::map_points<ft::memory_space::host> points(rgbd_frontend<executor>::map_slots);
  std::vector<int> holder(at(frontend.extractor().capacity()), -1);
  auto const& g = frontend.extractor().geometry();
  double farthest_off = 0;
  float furthest_right = 0;
  for (int i = 0; i < count; ++i) {
    ASSERT_GT(depth[at(i)], 0.0f) << "the plane is everywhere";
    EXPECT_NEAR(right_x[at(i)], x[at(i)] - rig.bf() / depth[at(i)], 1e-3f);
    auto const ray = rig.camera.unproject({x[at(i)], y[at(i)]}).direction;
    float const z = depth[at(i)];
    ft::vec3<float> const p{ray.x * z, ray.y * z, z};
    farthest_off = std::max(farthest_off, std::abs(plane::distance({p.x, p.y, p.z})));
    furthest_right = std::max(furthest_right, p.x);
    float const distance = std::sqrt(ft::dot(p, p));
    float const farthest = distance * g.scale[octave[at(i)]];
    auto const v = points.view();
    v.position(i) = p;
    v.normal(i) = {p.x / distance, p.y / distance, p.z / distance};
    v.max_distance(i) = farthest;
    v.min_distance(i) = farthest / g.scale[g.levels - 1];
    v.observations(i) = 1;
    v.orb(i) = descriptors[at(i)];
    holder[at(i)] = i;
  }
  // The depth is that of the pixel that a keypoint falls into: up to one pixel away in both axes,
  // and where the plane is 3.5 m away a pixel to the side is 5 mm of depth.
  EXPECT_LT(farthest_off, 0.008);
  EXPECT_GT(furthest_right, 1.2f) << "points up to the image's edge";
  points.view().count[0] = count;
  ft::copy(exec, frontend.map(), points.view());
  exec.wait();

  // ---- the second frame from the first one
  frontend.remember(holder);
  frontend.see(second);
  auto const start = between(T_first, T_second);
  ASSERT_GT(start.metres, 0.08f);
  ASSERT_GT(start.radians, 0.024f);
  int const from_last = frontend.track_motion(T_first, T_first);
  EXPECT_GT(from_last, 200);
  EXPECT_GT(frontend.inliers(), from_last * 9 / 10);
  auto const motion = between(frontend.pose(), T_second);
  EXPECT_LT(motion.metres, 0.006f);
  EXPECT_LT(motion.radians, 0.002f);

  // ---- more of it in the local map: points that no keypoint holds
  auto const held = frontend.holder();
  int const inliers = frontend.inliers();
  std::vector<int> others;
  for (int i = 0; i < count; ++i) {
    if (std::find(held.begin(), held.end(), i) == held.end()) { others.push_back(i); }
  }
  int const more = frontend.track_local(others);
  EXPECT_GT(more, 10);
  EXPECT_GT(frontend.inliers(), inliers);
  auto const local = between(frontend.pose(), T_second);
  EXPECT_LT(local.metres, 0.006f);
  EXPECT_LT(local.radians, 0.002f);

  // ---- and from the map alone
  frontend.forget();
  std::vector<int> all(at(count));
  for (int i = 0; i < count; ++i) { all[at(i)] = i; }
  ft::pose const near_by = moved(0.015f, -0.01f, {0.04f, -0.02f, 0.05f});
  EXPECT_GT(frontend.track_local(all, &near_by), 200);
  auto const alone = between(frontend.pose(), T_second);
  EXPECT_LT(alone.metres, 0.006f);
  EXPECT_LT(alone.radians, 0.002f);
  this->RecordProperty("motion_um", static_cast<int>(1e6f * motion.metres));
  this->RecordProperty("local_um", static_cast<int>(1e6f * local.metres));
  this->RecordProperty("alone_um", static_cast<int>(1e6f * alone.metres));
  this->RecordProperty("matches", from_last);
}

// ---- rectification ----------------------------------------------------------------------------

TYPED_TEST(rgbd_test, rectified_images_go_straight_into_the_extractor) {
  using executor = typename TypeParam::exec_type;
  auto const& exec = this->backend.exec;
  plane const world;
  auto const left = distorted();
  camera_type const right{258.0f, 259.0f, 198.0f, 152.0f, {-0.25f, 0.07f, -3e-4f, 5e-4f, -0.01f}};
  // The rectified pair looks along z; the cameras are turned against it.
  auto const rig = ft::rectified_rig::make({230.0f, 230.0f, 199.5f, 149.5f}, 0.12f);
  ft::pose const T_left = moved(0.02f, 0.01f, {0, 0, 0});
  ft::pose const T_right = moved(-0.01f, -0.02f, {0.12f, 0, 0});
  picture const images[2] = {render(world, left, T_left), render(world, right, T_right)};

  // Once: the maps.
  ft::remap_table<executor::space> maps({width, height, width, height}, 2);
  auto const turn = [](ft::pose const& T) { return T.cast<double>().R; };
  ft::build_remap(exec, left, turn(T_left), rig.camera, maps.view(), 0);
  ft::build_remap(exec, right, turn(T_right), rig.camera, maps.view(), 1);
  ft::orb_extractor<executor> extractor(exec, orb(), 2);
  ft::stereo_matcher<executor> matcher(rig, extractor);
  ft::image_pyramid<executor::space> raw(ft::pyramid_geometry::make(width, height, 1, 1.2f), 2);
  auto const source = ft::level_images(raw.view(), 0);

  // Per frame: raw images up, through the maps into level 0, features, stereo.
  for (int i = 0; i < 2; ++i) {
    ft::copy_image(exec, source[i], {images[i].grey.data(), width, height, width});
  }
  ft::rectify(exec, source, maps.view(), ft::level_images(extractor.pyramid(), 0));
  extractor.extract(exec);
  matcher.match(exec, extractor);
  exec.wait();

  auto const kp = extractor.keypoints();
  int const count = test::from_exec(exec, static_cast<int const*>(kp.count), 2)[0];
  auto const x = test::column<ft::field::x>(exec, kp);
  auto const y = test::column<ft::field::y>(exec, kp);
  auto const depth = test::column<ft::field::depth>(exec, matcher.matches());
  std::vector<double> off;  // of the plane, in disparity
  for (int i = 0; i < count; ++i) {
    if (!(depth[at(i)] > 0)) { continue; }
    auto const ray = rig.camera.unproject({x[at(i)], y[at(i)]}).direction;
    double const true_depth =
        2.5 / (0.25 * static_cast<double>(ray.x) + 0.15 * static_cast<double>(ray.y) + 1);
    off.push_back(std::abs(static_cast<double>(rig.bf()) *
                           (1 / true_depth - 1 / static_cast<double>(depth[at(i)]))));
  }
  ASSERT_GT(off.size(), 200u);
  std::sort(off.begin(), off.end());
  EXPECT_LT(off[off.size() / 2], 0.15) << "pixels, median";
  EXPECT_LT(off[off.size() * 9 / 10], 0.6);
  this->RecordProperty("matches", static_cast<int>(off.size()));
  this->RecordProperty("median_millipixels", static_cast<int>(1000 * off[off.size() / 2]));
  this->RecordProperty("p90_millipixels", static_cast<int>(1000 * off[off.size() * 9 / 10]));
}

}  // namespace rgbd_pipeline

// SPDX-License-Identifier: Apache-2.0
/// @file A rig of two fisheye pairs, a pinhole and a depth camera, and its parts alone, with and
/// without the IMU, on generated sequences: error, lost frames, time.
#include <CLI/CLI.hpp>
#include <Eigen/Geometry>

#include <algorithm>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <string>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/generator.hpp"
#include "examples/sequence/parallel.hpp"
#include "ft/any_odometry.hpp"

namespace {

ft::rigid<double> rigid_of(Eigen::Isometry3d const& T) {
  ft::rigid<double> out;
  for (int i = 0; i < 9; ++i) { out.R.m[i] = T.linear()(i / 3, i % 3); }
  out.t = {T.translation().x(), T.translation().y(), T.translation().z()};
  return out;
}

ft::camera_description camera_of(seq::camera_intrinsics const& c,
                                 Eigen::Isometry3d const& T_body_camera) {
  auto camera = ft::camera_description::make(ft::camera_kind::pinhole, {c.fx, c.fy, c.cx, c.cy});
  if (c.model == seq::lens::kannala_brandt) {
    camera.kind = ft::camera_kind::kannala_brandt;
    std::copy(c.distortion.begin(), c.distortion.end(), camera.parameters + 4);
  }
  camera.T_camera_body = rigid_of(T_body_camera.inverse());
  return camera;
}

/// All images of a frame, in the order of the cameras.
struct frame {
  std::int64_t time_ns = 0;
  std::vector<seq::image> grey;
  std::vector<seq::depth_image> depth;
};

struct recording {
  seq::generator const& source;
  std::vector<frame> frames;

  explicit recording(seq::generator const& of)
      : source(of), frames(static_cast<std::size_t>(of.size())) {
    seq::parallel_for(of.size(), 0, [&](int i) {
      frame& f = frames[static_cast<std::size_t>(i)];
      seq::stereo_frame pair = of.render(i);
      f.time_ns = pair.time_ns;
      f.grey = {std::move(pair.left), std::move(pair.right)};
      f.depth.resize(2);
      for (int k = 0; k < static_cast<int>(of.options().further.size()); ++k) {
        seq::further_image more = of.render_further(i, k);
        f.grey.push_back(std::move(more.grey));
        f.depth.push_back(std::move(more.depth));
      }
    });
  }
};

/// A rig of some of the recording's cameras. The body is the left camera of the first pair.
struct part {
  std::string name;
  std::vector<int> cameras;
  bool as_fisheye_pair = false;
};

ft::rig_description rig_of(seq::generator const& source, part const& p) {
  seq::stereo_rig const& pair = source.rig();
  auto const& further = source.options().further;
  std::vector<ft::camera_description> all = {camera_of(pair.left, Eigen::Isometry3d::Identity()),
                                             camera_of(pair.right, pair.T_left_right)};
  all[0].right = 1;
  for (std::size_t k = 0; k < further.size(); ++k) {
    all.push_back(camera_of(further[k].camera, further[k].T_left_this));
    all.back().has_depth_image = further[k].has_depth;
    if (further[k].has_depth) { all.back().baseline = 0.08; }
    if (further[k].right_of >= 0) {
      all[static_cast<std::size_t>(2 + further[k].right_of)].right = static_cast<int>(2 + k);
    }
  }
  if (p.as_fisheye_pair) {
    return ft::rig_description::fisheye_pair(all[0], all[1], rigid_of(pair.T_left_right.inverse()));
  }
  ft::rig_description rig;
  rig.kind = ft::rig_kind::multi;
  rig.cameras = static_cast<int>(p.cameras.size());
  rig.depth_scale = 0.001;
  rig.max_depth = 5;
  for (int i = 0; i < rig.cameras; ++i) {
    rig.camera[i] = all[static_cast<std::size_t>(p.cameras[static_cast<std::size_t>(i)])];
    auto const at = std::find(p.cameras.begin(), p.cameras.end(), rig.camera[i].right);
    rig.camera[i].right = at == p.cameras.end() ? -1 : static_cast<int>(at - p.cameras.begin());
  }
  return rig;
}

ft::gray_view view_of(seq::image const& i) { return {i.pixels.data(), i.width, i.height, i.width}; }
ft::any_images images_of(frame const& f, part const& p) {
  ft::any_images images;
  ft::gray_view* to = images.gray;
  ft::depth_view* depths = images.depths;
  for (int const c : p.cameras) {
    auto const at = static_cast<std::size_t>(c);
    *to++ = view_of(f.grey[at]);
    seq::depth_image const& d = f.depth[at];
    if (d.pixels.empty()) { continue; }
    *depths++ = ft::image_view<std::uint16_t const>{d.pixels.data(), d.width, d.height, d.width};
  }
  return images;
}

struct result {
  double ate_mm = -1;
  int lost = 0;
  double p50_ms = 0, p99_ms = 0;
  int imu_frames = 0;
};

ft::odometry_params params_of(seq::generator const& source, bool imu) {
  ft::odometry_params p;
  p.orb.width = source.options().width;
  p.orb.height = source.options().height;
  p.orb.features = 1000;
  p.map_slots = 32768;
  p.local_points = 12288;
  p.window_points = 12288;
  if (!imu) { return p; }
  auto const f = [](double v) { return static_cast<float>(v); };
  seq::imu_noise const& n = source.options().imu;
  p.imu.present = true;
  p.imu.T_bc = rigid_of(source.rig().T_body_left);
  p.imu.noise = {f(n.gyro), f(n.accel), f(n.gyro_walk), f(n.accel_walk),
                 f(source.options().imu_rate)};
  return p;
}

result run(recording const& r, part const& p, bool imu, ft::device const& where) {
  auto odometry = ft::make_odometry(where, rig_of(r.source, p), params_of(r.source, imu));
  std::vector<seq::imu_sample> const samples =
      imu ? r.source.imu() : std::vector<seq::imu_sample>();
  auto next = samples.begin();
  auto const narrow = [](Eigen::Vector3d const& v) {
    return ft::vec3<float>{static_cast<float>(v.x()), static_cast<float>(v.y()),
                           static_cast<float>(v.z())};
  };
  seq::trajectory poses;
  std::vector<double> times;
  result out;
  for (frame const& f : r.frames) {
    for (; next != samples.end() && next->time_ns <= f.time_ns; ++next) {
      odometry.add_imu({next->time_ns, narrow(next->accel), narrow(next->gyro)});
    }
    ft::any_images const images = images_of(f, p);
    auto const begun = std::chrono::steady_clock::now();
    ft::tracking const t = odometry.track(images, f.time_ns);
    std::chrono::duration<double, std::milli> const took = std::chrono::steady_clock::now() - begun;
    times.push_back(took.count());
    out.imu_frames += static_cast<int>(t.imu.optimized);
    if (t.state != ft::tracking_state::tracking) {
      ++out.lost;
      continue;
    }
    seq::stamped_pose pose;
    pose.time_ns = f.time_ns;
    for (int i = 0; i < 9; ++i) {
      pose.T_world_camera.linear()(i / 3, i % 3) = t.T_world_camera.R.m[i];
    }
    auto const& at = t.T_world_camera.t;
    pose.T_world_camera.translation() = Eigen::Vector3d(at.x, at.y, at.z);
    poses.push_back(pose);
  }
  auto const error = seq::evaluate(poses, r.source.ground_truth(), true);
  if (error.ate_rmse_m) { out.ate_mm = 1000 * *error.ate_rmse_m; }
  std::sort(times.begin(), times.end());
  out.p50_ms = times[times.size() / 2];
  out.p99_ms = times[times.size() * 99 / 100];
  return out;
}

}  // namespace

int main(int argc, char** argv) {
  int frames = 200;
  double fps = 20;
  std::vector<std::uint64_t> seeds = {1, 2, 3};
  ft::device where;
  CLI::App app("A rig of cameras of several models beside its parts, on generated sequences.");
  app.add_option("--frames", frames, "of a sequence")->capture_default_str();
  app.add_option("--fps", fps, "frames per second")->capture_default_str();
  app.add_option("--seeds", seeds, "of the sequences")->capture_default_str();
  app.add_option("--gpu", where.gpu, "number of a GPU; -1 = the host")->capture_default_str();
  app.add_option("--threads", where.threads, "of the host; 0 = all")->capture_default_str();
  try {
    app.parse(argc, argv);
  } catch (CLI::ParseError const& e) { return app.exit(e) == 0 ? 0 : 2; }
  std::vector<part> const parts = {{"all six cameras", {0, 1, 2, 3, 4, 5}, false},
                                   {"both fisheye pairs", {0, 1, 2, 3}, false},
                                   {"first pair", {0, 1}, false},
                                   {"first pair, fisheye_pair", {0, 1}, true},
                                   {"second pair", {2, 3}, false},
                                   {"depth camera", {5}, false}};
  try {
    std::printf(
        "| seed | cameras | IMU | ATE mm | frames without a pose | with the IMU | p50 ms | "
        "p99 ms |\n|---|---|---|---|---|---|---|---|\n");
    for (std::uint64_t const seed : seeds) {
      seq::generator_options options;
      options.frames = frames;
      options.fps = fps;
      options.seed = seed;
      seq::use_mixed_rig(options);
      seq::generator const source(options);
      recording const r(source);
      for (part const& p : parts) {
        for (bool const imu : {false, true}) {
          result const e = run(r, p, imu, where);
          std::printf("| %llu | %s | %s | %.2f | %d | %d | %.3f | %.3f |\n",
                      static_cast<unsigned long long>(seed), p.name.c_str(), imu ? "yes" : "no",
                      e.ate_mm, e.lost, e.imu_frames, e.p50_ms, e.p99_ms);
          std::fflush(stdout);
        }
      }
    }
  } catch (std::exception const& e) {
    std::fprintf(stderr, "ft_mixed_rigs: %s\n", e.what());
    return 1;
  }
  return 0;
}

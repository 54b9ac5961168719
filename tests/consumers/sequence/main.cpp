// SPDX-License-Identifier: Apache-2.0
// Writes a recording of a wall 2 m away that moves by 0.02 m a frame, as its user would have one,
// opens it and tracks it on the host.
//   consumer FOLDER
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <exception>
#include <filesystem>
#include <fstream>
#include <random>
#include <string>
#include <vector>

#include "ft/any_odometry.hpp"
#include "ft/sequence/image_io.hpp"
#include "ft/sequence/odometry_input.hpp"
#include "ft/sequence/reader.hpp"
#include "ft/version.hpp"

namespace {

constexpr int width = 320, height = 240, frames = 8;
constexpr int step = 2, disparity = 10;  // pixels: f = 200, 0.1 m from camera to camera

void write_recording(std::string const& folder) {
  constexpr int side = 5, columns = 100;  // squares of one grey
  std::mt19937 bits(3);
  std::vector<std::uint8_t> grey(columns * columns);
  for (auto& g : grey) { g = static_cast<std::uint8_t>(bits() >> 24); }
  for (int camera = 0; camera < 2; ++camera) {
    std::string const name = folder + (camera == 0 ? "/left" : "/right");
    std::filesystem::create_directories(name);
    for (int i = 0; i < frames; ++i) {
      seq::image image{width, height, std::vector<std::uint8_t>(width * height)};
      for (int k = 0; k < width * height; ++k) {
        int const x = k % width + step * i + disparity * camera;
        image.pixels[static_cast<std::size_t>(k)] =
            grey[static_cast<std::size_t>(k / width / side * columns + x / side)];
      }
      seq::write_png(name + "/" + std::to_string(1000 + i) + ".5.png", image);
    }
  }
  std::ofstream(folder + "/camchain.yaml")
      << "cam0:\n  camera_model: pinhole\n  distortion_model: none\n  distortion_coeffs: []\n"
         "  intrinsics: [200, 200, 160, 120]\n  resolution: [320, 240]\n"
         "cam1:\n  camera_model: pinhole\n  distortion_model: none\n  distortion_coeffs: []\n"
         "  intrinsics: [200, 200, 160, 120]\n  resolution: [320, 240]\n"
         "  T_cn_cnm1: [[1, 0, 0, -0.1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]\n";
  seq::image mask{width, height, std::vector<std::uint8_t>(width * height, std::uint8_t{0})};
  std::fill_n(mask.pixels.begin(), width * height * 3 / 4, std::uint8_t{255});
  seq::write_png(folder + "/mask.png", mask);
}

}  // namespace

int main(int, char** argv) try {
  std::string const folder = argv[1];
  write_recording(folder);
  int tracked = 0;
  float lowest = 0;  // row of a keypoint of the finest level

  seq::open_options options;
  options.masks = {folder + "/mask.png"};  // of the left camera
  auto const recording = seq::sequence::open(folder, options);
  ft::any_odometry odometry =
      ft::make_odometry({}, seq::odometry_rig(recording), seq::odometry_settings(recording));
  seq::odometry_masks masks(recording);
  ft::tracking pose;
  for (int i = 0; i < recording.size(); ++i) {
    seq::stereo_frame const frame = recording.load(i);
    masks.set(odometry, frame);
    pose = odometry.track(seq::odometry_images(frame), frame.time_ns);
    tracked += pose.state == ft::tracking_state::tracking ? 1 : 0;
    ft::tracked_frame_view const& keys = odometry.keypoints();
    for (int k = 0; k < keys.keypoints[0]; ++k) {
      if (keys.octave[k] == 0) { lowest = std::max(lowest, keys.y[k]); }
    }
  }

  double const moved = 0.02 * (frames - 1);
  std::printf("ft %d.%d, %d of %d frames tracked, moved %.4f m of %.4f m, keypoints to row %.0f\n",
              ft::version_major, ft::version_minor, tracked, recording.size(),
              pose.T_world_camera.t.x, moved, static_cast<double>(lowest));
  bool const right = tracked == frames && recording.size() == frames &&
                     std::abs(pose.T_world_camera.t.x - moved) < 0.1 * moved && lowest > 0 &&
                     lowest < height * 0.75f + 1;
  return right ? 0 : 1;
} catch (std::exception const& e) {
  std::printf("%s\n", e.what());
  return 1;
}

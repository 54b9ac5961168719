// SPDX-License-Identifier: Apache-2.0
/// @file Tracks a camera pair with ft's odometry at a camera's rate, for the energy of a frame. See
/// README.md here.
#include <cstdint>
#include <exception>
#include <iostream>
#include <string>

#include "bench/peers/at_rate.hpp"
#include "examples/track_sequence/setup.hpp"

int main(int argc, char** argv) {
  try {
    if (argc != 4) {
      std::cerr << "usage: ft_client FOLDER HZ SECONDS\n";
      return 2;
    }
    app::arguments asked;
    asked.sequence = argv[1];
    asked.backend = "cuda";
    asked.imu = "off";
    auto const sequence = app::open_sequence(asked);
    auto setup = app::setup_of(asked, sequence);
    setup.params.prefetch = 0;
    std::string backend, device;
    ft::any_odometry odometry = app::make_odometry(asked, setup, backend, device);
    auto const gray = [](seq::image const& i) {
      return ft::gray_view{i.pixels.data(), i.width, i.height, i.width};
    };
    int lost = 0;
    peers::run_at_rate(sequence, std::stod(argv[2]), std::stod(argv[3]),
                       [&](seq::stereo_frame const& f, std::int64_t time_ns) {
                         ft::any_images images{{gray(f.left), gray(f.right)}, {}};
                         ft::tracking const t = odometry.track(images, time_ns);
                         if (t.state == ft::tracking_state::lost) { ++lost; }
                       });
    if (lost > 0) { std::cerr << lost << " frames lost\n"; }
  } catch (std::exception const& e) {
    std::cerr << "ft_client: " << e.what() << '\n';
    return 1;
  }
  return 0;
}

// SPDX-License-Identifier: Apache-2.0
// An odometry with loops for many laps: to and fro before a wall, with a map that forgets on the
// way, and a limit of keyframes that is reached again and again. Loops must be found to the end;
// the error of a lap and the memory must not grow. After 6000 frames and more a frame must not take
// more of the processor than one of an odometry that is a few laps old: the two go on by turns, so
// that a machine that gets slower, or waits actively, does so for both.
//
//     loops_soak [FRAMES [MS]]
//
// A frame begins MS milliseconds after the one before, or at once: then it may wait for a loop.
// On a GPU where nvcc compiles it (-x cu), else on the host's threads. Nothing but ft is needed.
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <exception>
#include <stdexcept>
#include <thread>
#include <vector>

#include "ft/pipelines/odometry.hpp"
#include "tests/end_to_end/soak_scene.hpp"
#include "tests/support/process_memory.hpp"

namespace loops_soak {

using namespace soak_scene;

constexpr int lap = 200;  ///< frames to and fro
constexpr std::int64_t period = 50'000'000;

ft::odometry_params params() {
  ft::odometry_params p;
  p.orb.width = width;
  p.orb.height = height;
  p.orb.features = 400;
  p.orb.levels = 6;
  p.map_slots = 1500;
  p.local_points = 1024;
  p.keyframes = 8;
  p.window_points = 1024;
  p.window = {4, 2};
  p.local_map.keyframes = 6;
  p.loops.present = true;
  p.loops.keyframes = 128;
  p.loops.recent = 8;
  return p;
}

/// Metres to the right of the start.
double place(int frame) { return 2.5 * (1 - std::cos(frame * 6.283185307 / lap)); }

/// What a lap was like.
struct lap_facts {
  double square = 0;  ///< mean of squared errors as each frame told its pose, m^2
  int tracked = 0, loops = 0;
  double cpu_ms = 0;           ///< of a frame, mean
  std::vector<float> wall_ms;  ///< of each frame
  test::usage memory;          ///< at its end
};

/// What a quarter of the run was like.
struct part_facts {
  double error_m = 0, cpu_ms = 0;
  float p50_ms = 0, p99_ms = 0;
  int loops = 0;
  test::usage memory;  ///< at its end

  part_facts(std::vector<lap_facts> const& laps, std::size_t from, std::size_t to) {
    double square = 0;
    std::vector<float> ms;
    for (std::size_t i = from; i < to; ++i) {
      square += laps[i].square;
      cpu_ms += laps[i].cpu_ms;
      ms.insert(ms.end(), laps[i].wall_ms.begin(), laps[i].wall_ms.end());
      loops += laps[i].loops;
    }
    auto const n = static_cast<double>(to - from);
    error_m = std::sqrt(square / n);
    cpu_ms /= n;
    std::sort(ms.begin(), ms.end());
    p50_ms = ms[ms.size() / 2];
    p99_ms = ms[ms.size() * 99 / 100];
    memory = laps[to - 1].memory;
  }
  void print(std::size_t number) const {
    std::printf(
        "quarter %zu: error %.4f m, %d loops, a frame p50 %.2f p99 %.2f ms, processor %.2f ms; "
        "KiB: resident %lld, heap %lld, device %lld\n",
        number, error_m, loops, static_cast<double>(p50_ms), static_cast<double>(p99_ms), cpu_ms,
        memory.resident / 1024, memory.heap / 1024, memory.device / 1024);
  }
};

double cpu_now_ms() { return 1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

template <typename Odometry>
lap_facts go_round(Odometry& odometry, std::vector<image> const& left,
                   std::vector<image> const& right, std::chrono::milliseconds distance,
                   std::int64_t& time) {
  auto const view = [](image const& i) { return ft::gray_view{i.data(), width, height, width}; };
  lap_facts facts;
  facts.wall_ms.reserve(lap);
  double const begin = cpu_now_ms();
  for (int f = 0; f < lap; ++f) {
    auto const i = static_cast<std::size_t>(std::min(f, lap - f));  // the way back: the same images
    auto const start = std::chrono::steady_clock::now();
    ft::tracking const t = odometry.track({view(left[i]), view(right[i])}, time += period);
    std::chrono::duration<float, std::milli> const took = std::chrono::steady_clock::now() - start;
    facts.wall_ms.push_back(took.count());
    std::this_thread::sleep_until(start + distance);
    auto const& p = t.T_world_camera.t;
    double const error = std::hypot(p.x - place(f), p.y, p.z);
    facts.square += error * error / lap;
    facts.tracked += static_cast<int>(t.state == ft::tracking_state::tracking);
    facts.loops += t.loops_closed;
  }
  facts.cpu_ms = (cpu_now_ms() - begin) / lap;
  return facts;
}

/// A search or a correction that runs beside the frames takes memory while it lasts.
test::usage memory_at_rest() {
  test::usage least = test::measure();
  for (int i = 0; i < 5; ++i) {
    std::this_thread::sleep_for(std::chrono::milliseconds(50));
    test::usage const now = test::measure();
    least = {std::min(least.resident, now.resident), std::min(least.heap, now.heap),
             std::min(least.device, now.device)};
  }
  return least;
}

/// The processor's time of a frame, in that of an odometry whose limit of keyframes has just been
/// reached.
template <typename Exec>
double wear(Exec const& exec, ft::odometry<Exec>& odometry, std::vector<image> const& left,
            std::vector<image> const& right, std::chrono::milliseconds distance,
            std::int64_t& time) {
  constexpr int turns = 14, compared = 8;
  ft::odometry<Exec> young(exec, rig(), params(), 1, ft::loops{});
  std::int64_t young_time = 0;
  double old_ms = 0, young_ms = 0;
  for (int n = 0; n < turns; ++n) {
    double const one = go_round(odometry, left, right, distance, time).cpu_ms;
    double const other = go_round(young, left, right, distance, young_time).cpu_ms;
    if (n < turns - compared) { continue; }
    old_ms += one;
    young_ms += other;
  }
  std::printf("a frame takes %.2f ms of the processor, of a young odometry %.2f ms\n",
              old_ms / compared, young_ms / compared);
  return old_ms / young_ms;
}

/// @return whether all is as it must be
template <typename Exec>
bool run(Exec const& exec, int frames, std::chrono::milliseconds distance) {
  std::vector<image> left, right;
  for (int i = 0; i <= lap / 2; ++i) {
    left.push_back(render(place(i), 0));
    right.push_back(render(place(i) + 0.2, 0));
  }
  ft::odometry<Exec> odometry(exec, rig(), params(), 1, ft::loops{});
  std::vector<lap_facts> laps;
  std::int64_t time = 0;
  int tracked = 0;
  for (int n = 0; n < frames / lap; ++n) {
    laps.push_back(go_round(odometry, left, right, distance, time));
    tracked += laps.back().tracked;
    if (odometry.placed_keyframes().size() > 128 + 64) {
      throw std::runtime_error("too many keyframes are kept");
    }
    laps.back().memory = memory_at_rest();
  }
  std::vector<part_facts> quarters;
  for (std::size_t q = 0; q < 4; ++q) {
    quarters.emplace_back(laps, q * laps.size() / 4, (q + 1) * laps.size() / 4);
    quarters.back().print(q + 1);
  }
  part_facts const& second = quarters[1];
  part_facts const& last = quarters[3];
  test::usage const& warm = laps[laps.size() / 2].memory;
  test::usage const& end = last.memory;
  bool const flat = end.resident - warm.resident <= 8 << 20 && end.heap - warm.heap <= 1 << 20 &&
                    end.device - warm.device <= 2 << 20;
  std::printf(
      "%d frames, %d tracked; growth of the second half, KiB: resident %lld, heap %lld, "
      "device %lld: %s\n",
      frames, tracked, (end.resident - warm.resident) / 1024, (end.heap - warm.heap) / 1024,
      (end.device - warm.device) / 1024, flat ? "flat" : "MEMORY GROWS");
  bool const steady = frames < 6000 || wear(exec, odometry, left, right, distance, time) < 1.3;
  if (!steady) { std::printf("FRAMES TAKE LONGER\n"); }
  bool const bounded = last.error_m < 0.05 && last.error_m < 1.5 * second.error_m;
  if (!bounded) { std::printf("THE ERROR GROWS\n"); }
  return flat && steady && bounded && tracked == frames / lap * lap && last.loops > 0;
}

}  // namespace loops_soak

int main(int argc, char** argv) {
  try {
    int const frames = argc > 1 ? std::atoi(argv[1]) : 1600;
    std::chrono::milliseconds const distance(argc > 2 ? std::atoi(argv[2]) : 0);
    if (frames < 8 * loops_soak::lap) { throw std::runtime_error("1600 frames or more"); }
    return soak_scene::on_backend([&](auto const& exec) {
      return loops_soak::run(exec, frames, distance) ? EXIT_SUCCESS : EXIT_FAILURE;
    });
  } catch (std::exception const& e) {
    std::fprintf(stderr, "loops_soak: %s\n", e.what());
    return EXIT_FAILURE;
  }
}

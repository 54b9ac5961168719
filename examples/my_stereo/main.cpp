// SPDX-License-Identifier: Apache-2.0
// A start for a program of yours: copy this file. It needs ft's headers and nothing else of ft. Two
// distorted cameras, a mask, the pose of every frame in a file, frames that are not found, and a
// picture of the keypoints. g++ -std=c++17 -O2 -Iinclude THIS.cpp -o my_stereo -ltbb -pthread
//   my_stereo LEFT RIGHT    folders of 8-bit PGM files that are named by their nanoseconds
//   my_stereo               without folders: a generated wall, half a second of it in the dark
#include <ft/ft.hpp>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

// ---- yours: the cameras, and what they do not see

using lens = ft::radtan5<float>;  // fx fy cx cy, then k1 k2 p1 p2 k3: OpenCV's K and D
using rig_type = ft::distorted_pair<lens>;

constexpr int my_width = 640, my_height = 400;  // pixels of the images

rig_type my_rig() {
  lens const left{420.0f, 421.0f, 318.0f, 203.0f, {-0.28f, 0.08f, 0.0003f, -0.0002f, 0}};
  lens const right{423.0f, 422.0f, 323.0f, 199.0f, {-0.29f, 0.09f, -0.0002f, 0.0001f, 0}};
  // Points of the left camera to the right one, metres: R and T of OpenCV's stereoCalibrate,
  // T_cn_cnm1 of Kalibr. The right camera is 0.12 m to the right, and looks 0.6 degrees outwards.
  float const c = 0.999945f, s = 0.010472f;
  ft::pose const T_rl{{{c, 0, -s, 0, 1, 0, s, 0, c}}, {-0.12f * c, 0, -0.12f * s}};
  return rig_type::make(left, right, T_rl, {400.0f, 400.0f, 320.0f, 200.0f});  // both, rectified
}

/// 0 where keypoints are not wanted: the vehicle, in the lower sixth of the rectified left image.
std::vector<std::uint8_t> my_mask() {
  std::vector<std::uint8_t> mask(std::size_t{my_width} * my_height, 255);
  std::fill(mask.begin() + std::ptrdiff_t{my_width} * (my_height - my_height / 6), mask.end(),
            std::uint8_t{0});
  return mask;
}

// ---- images

struct image {
  std::vector<std::uint8_t> pixels;
  ft::gray_view view() const { return {pixels.data(), my_width, my_height, my_width}; }
};

struct frame {
  std::int64_t time_ns = 0;
  image left, right;
};

image read_pgm(std::filesystem::path const& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) { throw std::runtime_error(path.string() + ": cannot be opened"); }
  std::string magic;
  int w = 0, h = 0, white = 0;
  file >> magic >> w >> h >> white;
  if (!file || magic != "P5" || w != my_width || h != my_height || white != 255) {
    throw std::runtime_error(path.string() + ": not an 8-bit PGM of " + std::to_string(my_width) +
                             "x" + std::to_string(my_height) + " but " + magic + " of " +
                             std::to_string(w) + "x" + std::to_string(h));
  }
  file.get();
  image read{std::vector<std::uint8_t>(std::size_t{my_width} * my_height)};
  if (!file.read(reinterpret_cast<char*>(read.pixels.data()),
                 std::ptrdiff_t{my_width} * my_height)) {
    throw std::runtime_error(path.string() + ": ends early");
  }
  return read;
}

std::int64_t time_of(std::filesystem::path const& path) {
  std::string const name = path.stem().string();
  if (name.empty() || name.size() > 18 || name.find_first_not_of("0123456789") < name.size()) {
    throw std::runtime_error(path.string() + ": its name is no time in nanoseconds");
  }
  return std::stoll(name);
}

/// Two folders with files of the same names.
class recorded_camera {
public:
  recorded_camera(std::string const& left, std::string const& right) : right_(right) {
    for (auto const& entry : std::filesystem::directory_iterator(left)) {
      if (entry.path().extension() == ".pgm") { files_.push_back(entry.path()); }
    }
    if (files_.empty()) { throw std::runtime_error(left + ": no file *.pgm"); }
    std::sort(files_.begin(), files_.end(),
              [](auto const& a, auto const& b) { return time_of(a) < time_of(b); });
  }
  bool next(frame& f) {
    if (next_ == files_.size()) { return false; }
    auto const& path = files_[next_++];
    f = {time_of(path), read_pgm(path), read_pgm(right_ / path.filename())};
    return true;
  }

private:
  std::filesystem::path right_;
  std::vector<std::filesystem::path> files_;
  std::size_t next_ = 0;
};

/// 40 frames of a wall at z = 3 m: the left camera goes to the right, 2 cm a frame. The vehicle's
/// edge is in the image, and frames 20 to 29 are black.
class generated_camera {
public:
  static constexpr int frames = 40, first_dark = 20, last_dark = 29;
  static double x_of(int i) { return 0.02 * i; }

  bool next(frame& f) {
    if (next_ == frames) { return false; }
    rig_type const rig = my_rig();
    ft::mat3<float> const R_right = (rig.R_left.transposed() * rig.R_right).cast<float>();
    f = {50'000'000 * std::int64_t{next_ + 1},
         render(rig.left, ft::mat3<float>::identity(), x_of(next_)),
         render(rig.right, R_right, x_of(next_) + 0.12)};
    ++next_;
    return true;
  }

private:
  /// @param R turns rays of the camera into the wall's frame @param x of the camera, m
  image render(lens const& camera, ft::mat3<float> const& R, double x) const {
    image seen{std::vector<std::uint8_t>(std::size_t{my_width} * my_height, 0)};
    if (next_ >= first_dark && next_ <= last_dark) { return seen; }
    for (int v = 0; v < my_height; ++v) {
      for (int u = 0; u < my_width; ++u) {
        auto const ray = camera.unproject({static_cast<float>(u), static_cast<float>(v)});
        ft::vec3<float> const d = R * ray.direction;
        bool const vehicle = v > my_height - my_height / 8;  // it goes along
        double const wall_x = vehicle ? u / 200.0 : x + 3.0 * static_cast<double>(d.x / d.z);
        double const wall_y = vehicle ? v / 200.0 : 3.0 * static_cast<double>(d.y / d.z);
        seen.pixels[static_cast<std::size_t>(v * my_width + u)] = texture(wall_x, wall_y);
      }
    }
    return seen;
  }
  static std::uint8_t texture(double x, double y) {
    auto const tile = [](double size, double a, double b) {
      auto const i = static_cast<std::uint32_t>(std::floor(a / size) + 1e6);
      auto const j = static_cast<std::uint32_t>(std::floor(b / size) + 1e6);
      std::uint32_t const h = (i * 2654435761u) ^ (j * 2246822519u);
      return static_cast<int>(((h >> 15) ^ h) * 2654435761u >> 25);  // 0 to 127
    };
    return static_cast<std::uint8_t>(tile(0.06, x, y) + tile(0.35, x, y));
  }
  int next_ = 0;
};

// ---- what is written

/// The left image as it came, with the keypoints that hold a point of the map in green.
void write_picture(std::string const& path, image const& left, rig_type const& rig,
                   ft::tracked_frame_view const& keypoints) {
  std::vector<std::uint8_t> rgb;
  for (std::uint8_t const grey : left.pixels) { rgb.insert(rgb.end(), 3, grey); }
  for (int k = 0; k < keypoints.keypoints[0]; ++k) {
    // Keypoints are those of the rectified image: back through the lens.
    auto const ray = rig.target.camera.unproject({keypoints.x[k], keypoints.y[k]});
    auto const p = rig.left.project(rig.R_left.transposed().cast<float>() * ray.direction);
    int const x = static_cast<int>(std::lround(p.pixel.x));
    int const y = static_cast<int>(std::lround(p.pixel.y));
    if (!p.valid || x < 1 || y < 1 || x >= my_width - 1 || y >= my_height - 1) { continue; }
    for (int i = 0; i < 9; ++i) {
      std::size_t const at =
          3 * static_cast<std::size_t>((y + i / 3 - 1) * my_width + x + i % 3 - 1);
      bool const mapped = keypoints.holder[k] >= 0;
      rgb[at] = mapped ? 0 : 255;
      rgb[at + 1] = mapped ? 255 : 0;
      rgb[at + 2] = 0;
    }
  }
  std::ofstream file(path, std::ios::binary);
  file << "P6\n" << my_width << " " << my_height << "\n255\n";
  file.write(reinterpret_cast<char const*>(rgb.data()), static_cast<std::ptrdiff_t>(rgb.size()));
}

struct quaternion {
  double x, y, z, w;
};
quaternion quaternion_of(ft::mat3<double> const& R) {
  auto const& m = R.m;
  auto const half = [](double s) { return std::sqrt(std::max(0.0, s)) / 2; };
  return {std::copysign(half(1 + m[0] - m[4] - m[8]), m[7] - m[5]),
          std::copysign(half(1 - m[0] + m[4] - m[8]), m[2] - m[6]),
          std::copysign(half(1 - m[0] - m[4] + m[8]), m[3] - m[1]), half(1 + m[0] + m[4] + m[8])};
}

/// A line a frame, in TUM's format: "seconds x y z qx qy qz qw" of the rectified left camera. A
/// frame without a pose is a comment that says why.
void write_pose(std::ofstream& file, std::int64_t time_ns, ft::tracking const& t) {
  char line[256];
  long long const s = time_ns / 1'000'000'000, ns = time_ns % 1'000'000'000;
  if (t.state == ft::tracking_state::tracking) {
    auto const& p = t.T_world_camera.t;
    auto const q = quaternion_of(t.T_world_camera.R);
    std::snprintf(line, sizeof line, "%lld.%09lld %.6f %.6f %.6f %.7f %.7f %.7f %.7f\n", s, ns, p.x,
                  p.y, p.z, q.x, q.y, q.z, q.w);
  } else {
    std::snprintf(line, sizeof line, "# %lld.%09lld %s\n", s, ns,
                  ft::name_of(ft::explain(t).reason));
  }
  file << line;
}

// ---- the loop

template <typename Exec, typename Camera, typename Seen>
void follow(Exec const& exec, Camera camera, Seen const& seen) {
  rig_type const rig = my_rig();
  for (auto const& found : ft::check_calibration(rig, my_width, my_height)) {
    std::printf("calibration: %s\n", found.text.c_str());
  }
  ft::odometry_params params;
  params.orb.width = params.orb.mask_width = my_width;
  params.orb.height = params.orb.mask_height = my_height;
  ft::odometry<Exec, rig_type> odometry(exec, rig, params);
  auto const mask = my_mask();
  odometry.set_mask(0, 0, {mask.data(), my_width, my_height, my_width});

  std::ofstream trajectory("my_stereo.txt");
  frame f;
  bool found = false;
  while (camera.next(f)) {
    ft::tracking const t = odometry.track({f.left.view(), f.right.view()}, f.time_ns);
    write_pose(trajectory, f.time_ns, t);
    // Lost: hold on to nothing but a prediction of yours (wheels: odometry.predict()). The odometry
    // goes on searching by itself, and begins a new map where it finds nothing.
    bool const now = t.state == ft::tracking_state::tracking;
    if (found && !now) { std::printf("lost: %s\n", ft::explain(t).text.c_str()); }
    if (!found && now) { std::printf("found, in map %d\n", t.maps); }
    // A map after the first begins at a guessed place: the path is broken there.
    if (t.map_begun && t.maps > 1) { trajectory << "# a new map\n"; }
    found = now;
    seen(t, odometry.keypoints());
  }
  if (f.time_ns != 0) { write_picture("my_stereo.ppm", f.left, rig, odometry.keypoints()); }
  if (!trajectory.flush()) { throw std::runtime_error("my_stereo.txt cannot be written"); }
}

/// Of the generated wall: whether the poses are right, the dark frames lost and the mask kept.
template <typename Exec>
int check(Exec const& exec) {
  auto const R = my_rig().R_left;  // the world is the rectified left camera of the first frame
  int i = 0, wrong = 0;
  double worst = 0;
  follow(exec, generated_camera{}, [&](ft::tracking const& t, ft::tracked_frame_view const& keys) {
    bool const dark = i >= generated_camera::first_dark && i <= generated_camera::last_dark;
    wrong += static_cast<int>((t.state == ft::tracking_state::tracking) == dark || t.maps != 1);
    auto const truth = R * ft::vec3<double>{generated_camera::x_of(i), 0, 0};
    auto const off = t.T_world_camera.t - truth;
    if (!dark) { worst = std::max(worst, std::sqrt(ft::dot(off, off))); }
    for (int k = 0; k < keys.keypoints[0]; ++k) {  // of the finest level, to the pixel
      wrong += static_cast<int>(keys.octave[k] == 0 && keys.y[k] > my_height - my_height / 6 + 1);
    }
    ++i;
  });
  std::printf("%d frames, at most %.1f mm off\n", i, 1000 * worst);
  std::ifstream trajectory("my_stereo.txt");
  int lines = 0;
  for (std::string line; std::getline(trajectory, line);) { ++lines; }
  bool const good = i == generated_camera::frames && lines == i && wrong == 0 && worst < 0.02;
  if (!good) { std::printf("%d lines, %d wrong: not what was expected\n", lines, wrong); }
  return good ? 0 : 1;
}

template <typename Exec>
int run(Exec const& exec, int argc, char** argv) {
  try {
    if (argc == 1) { return check(exec); }
    if (argc != 3) { throw std::runtime_error("usage: my_stereo [LEFT RIGHT]"); }
    follow(exec, recorded_camera(argv[1], argv[2]), [](auto const&, auto const&) {});
    return 0;
  } catch (std::exception const& e) {
    std::fprintf(stderr, "my_stereo: %s\n", e.what());
    return 1;
  }
}

int main(int argc, char** argv) {
#if defined(__CUDACC__)
  int devices = 0;
  if (cudaGetDeviceCount(&devices) != cudaSuccess || devices == 0) {
    std::puts("no CUDA device was found: nothing was run");
    return 77;
  }
  return run(ft::cuda_exec(cudaStreamPerThread), argc, argv);
#else
  return run(ft::host_exec(), argc, argv);
#endif
}

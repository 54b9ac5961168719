// SPDX-License-Identifier: Apache-2.0
// Any bytes where a calibration, a list of frames, ground truth, an image, a vocabulary or a pose
// graph is expected: read, or refused with seq::error or ft::error. The first byte says which file
// they are.
#include <unistd.h>

#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>
#include <string>
#include <vector>

#include "examples/sequence/calibration.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_files.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "ft/core/error.hpp"
#include "ft/pipelines/bundle_files.hpp"
#include "ft/pipelines/pose_graph_files.hpp"
#include "tests/fuzz/input.hpp"

namespace {

namespace fs = std::filesystem;

/// A folder of the process's own, in memory where the system has such a place.
class folder {
public:
  folder() {
    fs::path const memory = "/dev/shm";
    path_ = (fs::exists(memory) ? memory : fs::temp_directory_path()) /
            ("ft_fuzz_" + std::to_string(::getpid()));
    fs::create_directories(path_);
  }
  folder(folder const&) = delete;
  folder& operator=(folder const&) = delete;
  ~folder() {
    std::error_code ignored;
    fs::remove_all(path_, ignored);
  }
  std::string path(std::string const& name) const { return (path_ / name).string(); }
  void write(std::string const& name, std::string const& bytes) const {
    fs::create_directories((path_ / name).parent_path());
    std::ofstream(path_ / name, std::ios::binary) << bytes;
  }
  std::string read(std::string const& name) const {
    std::ifstream in(path_ / name, std::ios::binary);
    return {std::istreambuf_iterator<char>(in), {}};
  }

private:
  fs::path path_;
};

constexpr char const* sensor =
    "sensor_type: camera\n"
    "T_BS:\n  rows: 4\n  cols: 4\n  data: [1, 0, 0, %s, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
    "rate_hz: 20\nresolution: [16, 12]\ncamera_model: pinhole\n"
    "intrinsics: [10, 10, 8, 6]\ndistortion_model: radial-tangential\n"
    "distortion_coefficients: [0, 0, 0, 0]\n";

constexpr char const* imu_sensor =
    "sensor_type: imu\n"
    "T_BS:\n  rows: 4\n  cols: 4\n  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\n"
    "rate_hz: 200\ngyroscope_noise_density: 1.7e-4\ngyroscope_random_walk: 2e-5\n"
    "accelerometer_noise_density: 2e-3\naccelerometer_random_walk: 3e-3\n";

std::string sensor_at(char const* x) {
  char text[600];
  std::snprintf(text, sizeof text, sensor, x);
  return text;
}

void check_imu(seq::imu_recording const& imu) {
  auto const& c = imu.calibration;
  fuzz::require(!imu.samples.empty() && c.rate_hz >= 1 && c.noise.gyro > 0 && c.noise.accel > 0 &&
                    c.noise.gyro_walk > 0 && c.noise.accel_walk > 0,
                "an IMU that is read can be used");
  fuzz::require(imu.T_imu_left.matrix().allFinite(), "the IMU has a place");
  for (std::size_t i = 0; i < imu.samples.size(); ++i) {
    auto const& s = imu.samples[i];
    fuzz::require(s.gyro.allFinite() && s.accel.allFinite(), "samples are finite");
    fuzz::require(i == 0 || imu.samples[i - 1].time_ns < s.time_ns, "samples ascend");
  }
}

/// Sequences of two frames, complete but for what the fuzzer writes in its place.
class sequences {
public:
  sequences() {
    std::string const list = "#timestamp,filename\n1000,1000.png\n2000,2000.png\n";
    for (char const* camera : {"euroc/mav0/cam0/", "euroc/mav0/cam1/"}) {
      std::string const at = camera;
      files_.write(at + "sensor.yaml",
                   sensor_at(at.find("cam0") != std::string::npos ? "0" : "0.1"));
      files_.write(at + "data.csv", list);
      for (char const* name : {"data/1000.png", "data/2000.png"}) { picture(at + name); }
    }
    files_.write("euroc/mav0/state_groundtruth_estimate0/data.csv", "1000,0,0,0,1,0,0,0\n");
    files_.write("euroc/mav0/imu0/sensor.yaml", imu_sensor);
    files_.write("euroc/mav0/imu0/data.csv", "900,0,0,0,0,0,9.81\n1900,0,0,0,0,0,9.81\n");
    files_.write("kitti/calib.txt",
                 "P0: 10 0 8 0 0 10 6 0 0 0 1 0\nP1: 10 0 8 -5 0 10 6 0 0 0 1 0\n");
    files_.write("kitti/times.txt", "0.0\n0.1\n");
    files_.write("kitti/poses.txt", "1 0 0 0 0 1 0 0 0 0 1 0\n1 0 0 1 0 1 0 0 0 0 1 0\n");
    for (char const* name :
         {"image_0/000000.png", "image_0/000001.png", "image_1/000000.png", "image_1/000001.png"}) {
      picture(std::string("kitti/") + name);
    }
    files_.write("tum/rgb.txt", "1.0 rgb/0.png\n1.1 rgb/1.png\n");
    files_.write("tum/depth.txt", "1.001 depth/0.png\n1.101 depth/1.png\n");
    files_.write("tum/camera.txt", "# depth in units of 1 mm\n10 10 8 6 0.01 0 0 0\n");
    files_.write("tum/groundtruth.txt", "1.0 0 0 0 0 0 0 1\n1.1 1 0 0 0 0 0 1\n");
    fs::create_directories(files_.path("tum/depth"));
    for (char const* name : {"0.png", "1.png"}) {
      picture(std::string("tum/rgb/") + name);
      seq::write_depth_png(files_.path(std::string("tum/depth/") + name),
                           {16, 12, std::vector<std::uint16_t>(16 * 12, 2000)});
    }
    files_.write("scenes/camera.txt", "10 10 8 6\n");
    for (char const* name : {"scenes/frame-000000", "scenes/frame-000001"}) {
      std::string const at = name;
      picture(at + ".color.png");
      seq::write_depth_png(files_.path(at + ".depth.png"),
                           {16, 12, std::vector<std::uint16_t>(16 * 12, 2000)});
      files_.write(at + ".pose.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n");
    }
    write_raw_drive();
    files_.write("folders/times.txt", "0.0\n0.1\n");
    files_.write(
        "folders/stereo.yaml",
        "K1: [[10, 0, 8], [0, 10, 6], [0, 0, 1]]\nK2: [[10, 0, 8], [0, 10, 6], [0, 0, 1]]\n"
        "D1: [0, 0, 0, 0]\nD2: [0, 0, 0, 0]\nR: [0, 0, 0]\nT: [-0.1, 0, 0]\n");
    for (char const* name : {"left/0.png", "left/1.png", "right/0.png", "right/1.png"}) {
      picture(std::string("folders/") + name);
    }
  }
  /// Opens the sequence with `bytes` as one of its files and loads what it lists.
  void open_with(std::string const& sequence, std::string const& file,
                 std::string const& bytes) const {
    std::string const name = sequence + "/" + file;
    std::string const before = files_.read(name);
    files_.write(name, bytes);
    try {
      seq::open_options options;
      options.max_frames = 2;
      options.read_imu = true;
      auto const opened = seq::sequence::open(files_.path(sequence), options);
      fuzz::require(opened.size() >= 1, "an opened sequence has a frame");
      bool const pair = opened.kind() == seq::camera_kind::stereo;
      bool const depth = opened.kind() == seq::camera_kind::rgbd;
      fuzz::require((opened.depth_unit() > 0) == depth, "a depth has a unit");
      if (auto const& imu = opened.imu()) { check_imu(*imu); }
      for (int i = 0; i < opened.size(); ++i) {
        auto const frame = opened.load(i);
        fuzz::require(frame.left.width == opened.rig().left.width &&
                          (!pair || frame.right.width == opened.rig().right.width) &&
                          (!depth || frame.depth.pixels.size() == frame.left.pixels.size()),
                      "frames have the rig's size");
      }
    } catch (seq::error const&) {}
    if (before.empty()) {
      fs::remove(files_.path(name));
    } else {
      files_.write(name, before);
    }
  }
  folder const& files() const { return files_; }

private:
  /// KITTI raw's
  void write_raw_drive() const {
    std::string const dates = "2011-09-26 13:02:25.9\n2011-09-26 13:02:26.0\n";
    for (char const* camera : {"raw/image_00/", "raw/image_01/"}) {
      std::string const at = camera;
      files_.write(at + "timestamps.txt", dates);
      picture(at + "data/0000000000.png");
      picture(at + "data/0000000001.png");
    }
    files_.write("raw/calib_cam_to_cam.txt",
                 "S_rect_00: 16 12\nR_rect_00: 1 0 0 0 1 0 0 0 1\n"
                 "P_rect_00: 10 0 8 0 0 10 6 0 0 0 1 0\nP_rect_01: 10 0 8 -5 0 10 6 0 0 0 1 0\n");
    for (char const* name : {"raw/calib_imu_to_velo.txt", "raw/calib_velo_to_cam.txt"}) {
      files_.write(name, "R: 1 0 0 0 1 0 0 0 1\nT: 0 0 0\n");
    }
    files_.write("raw/oxts/timestamps.txt", dates);
    files_.write("raw/oxts/data/0000000000.txt", "49 8 100 0 0 0\n");
    files_.write("raw/oxts/data/0000000001.txt", "49.1 8 100 0 0 0.1\n");
  }
  void picture(std::string const& name) const {
    fs::create_directories(fs::path(files_.path(name)).parent_path());
    seq::write_png(files_.path(name), {16, 12, std::vector<std::uint8_t>(16 * 12, 40)});
  }
  folder files_;
};

void read_settings(folder const& files, std::string const& bytes) {
  files.write("settings.yaml", bytes);
  try {
    auto const read = seq::read_calibration(files.path("settings.yaml"), 16, 12);
    fuzz::require(read.rig.left.fx > 0 && read.rig.right.fy > 0 && read.rig.baseline() > 0,
                  "a rig that is read can be used");
  } catch (seq::error const&) {}
  for (auto const kind : {seq::camera_kind::mono, seq::camera_kind::rgbd}) {
    try {
      auto const read = seq::read_calibration(files.path("settings.yaml"), 16, 12, 0, kind);
      fuzz::require(read.rig.left.fx > 0 && read.depth_unit.value_or(1) > 0 &&
                        (read.rig.baseline() > 0) == (kind == seq::camera_kind::rgbd),
                    "a camera that is read can be used");
    } catch (seq::error const&) {}
  }
}

/// A pair of COLMAP: `bytes` are its rigs.txt.
void read_rigs(folder const& files, std::string const& bytes) {
  files.write("colmap/cameras.txt", "1 PINHOLE 16 12 10 10 8 6\n2 PINHOLE 16 12 10 10 8 6\n");
  files.write("colmap/rigs.txt", bytes);
  try {
    auto const read = seq::read_calibration(files.path("colmap/cameras.txt"), 16, 12);
    fuzz::require(read.rig.baseline() > 0 && read.rig.T_left_right.matrix().allFinite(),
                  "a pair that is read has a baseline");
  } catch (seq::error const&) {}
}

void read_picture(folder const& files, std::string const& bytes) {
  files.write("picture", bytes);
  try {
    int width = 0;
    int height = 0;
    seq::read_image_size(files.path("picture"), width, height);
    if (width * height > 1 << 22) { return; }  // takes time, and nothing new is seen
    auto const read = seq::read_image(files.path("picture"));
    fuzz::require(read.width == width && read.height == height &&
                      read.pixels.size() ==
                          static_cast<std::size_t>(width) * static_cast<std::size_t>(height),
                  "an image has the pixels that its header says");
    int const largest = seq::largest_sample_of_16_bits(files.path("picture"));
    fuzz::require(largest >= -1 && largest <= 65535, "a sample has 16 bits");
    fuzz::require(seq::read_image(files.path("picture"), 12).pixels.size() == read.pixels.size(),
                  "a range changes no size");
  } catch (seq::error const&) {}
}

/// What a stage relies on: children in range and below their parents, words in range.
void check_vocabulary(ft::vocabulary_view const& v) {
  fuzz::require(v.nodes >= 1 && v.header.levels <= ft::max_vocabulary_levels, "it has a root");
  std::vector<int> depth(static_cast<std::size_t>(v.nodes));
  int words = 0;
  for (int i = 0; i < v.nodes; ++i) {
    auto const& c = v.children[i];
    fuzz::require(c.count >= 0 && c.count <= v.header.branching, "a warp has a lane a child");
    fuzz::require(c.count == 0 || (c.first > i && c.first + c.count <= v.nodes),
                  "children lie after their parent");
    for (int k = 0; k < c.count; ++k) {
      auto& of_child = depth[static_cast<std::size_t>(c.first + k)];
      of_child = depth[static_cast<std::size_t>(i)] + 1;
      fuzz::require(of_child <= v.header.levels, "no node is deeper than the header says");
    }
    bool const leaf = i > 0 && c.count == 0;
    fuzz::require(leaf == (v.word[i] < static_cast<std::uint32_t>(v.words)), "leaves are words");
    words += static_cast<int>(leaf);
  }
  fuzz::require(words == v.words, "each word has a node");
}

void read_vocabulary_text(std::string const& bytes) {
  std::istringstream in(bytes);
  try {
    check_vocabulary(ft::read_vocabulary_text(in).view());
  } catch (ft::error const&) {}
}

/// @param mend gives the file the checksum of its bytes, which no fuzzer guesses
void load_vocabulary(std::string bytes, bool mend) {
  if (mend && bytes.size() > 52) {
    ft::detail::vocabulary_file_head head;
    std::memcpy(&head, bytes.data(), sizeof head);
    std::size_t const nodes = (bytes.size() - 52) / ft::detail::vocabulary_node_bytes;
    bytes.resize(52 + nodes * ft::detail::vocabulary_node_bytes);
    head.nodes = static_cast<std::int32_t>(nodes);
    std::memcpy(bytes.data(), &head, sizeof head);
    ft::detail::checksum sum;
    std::size_t at = 0;
    for (std::size_t const part :
         {sizeof head, nodes, 4 * nodes, 4 * nodes, 8 * nodes, 32 * nodes}) {
      sum.add(bytes.data() + at, part);
      at += part;
    }
    std::uint64_t const value = sum.value();
    std::memcpy(bytes.data() + at, &value, sizeof value);
  }
  std::istringstream in(bytes);
  try {
    auto const read = ft::load_vocabulary(in);
    check_vocabulary(read.view());
    std::ostringstream again;
    ft::save_vocabulary(again, read.view());
    fuzz::require(again.str() == bytes, "a file that is read is written as it was");
  } catch (ft::error const&) {}
}

/// What is read is a valid graph, and can be written.
template <typename Read>
void read_graph(std::string const& bytes, Read const& read) {
  std::istringstream in(bytes);
  try {
    auto const graph = read(in);
    std::ostringstream again;
    fuzz::require(fuzz::accepted<ft::error>([&] { ft::write_g2o(again, graph); }),
                  "a pose graph that is read is written");
  } catch (ft::error const&) {}
}

void read_bundle(std::string const& bytes) {
  std::istringstream in(bytes);
  std::ostringstream again;
  try {
    ft::write_bal(again, ft::read_bal(in));  // which refuses views that see nothing, too
  } catch (ft::error const&) {}
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(std::uint8_t const* data, std::size_t size) {
  if (size == 0) { return 0; }
  static sequences const s;
  std::string const bytes(reinterpret_cast<char const*>(data) + 1, size - 1);
  switch (data[0] % 28) {
    case 1:
      s.open_with("euroc", "mav0/cam0/sensor.yaml", bytes);
      break;
    case 2:
      s.open_with("euroc", "mav0/cam1/data.csv", bytes);
      break;
    case 3:
      s.open_with("euroc", "mav0/state_groundtruth_estimate0/data.csv", bytes);
      break;
    case 4:
      s.open_with("kitti", "calib.txt", bytes);
      break;
    case 5:
      s.open_with("kitti", "times.txt", bytes);
      break;
    case 6:
      s.open_with("kitti", "poses.txt", bytes);
      break;
    case 7:
      s.open_with("kitti", "image_1/000001.png", bytes);
      break;
    case 8:
      read_picture(s.files(), bytes);
      break;
    case 9:
      s.open_with("euroc", "mav0/imu0/data.csv", bytes);
      break;
    case 10:
      s.open_with("euroc", "mav0/imu0/sensor.yaml", bytes);
      break;
    case 11:
      read_rigs(s.files(), bytes);
      break;
    case 12:
      read_vocabulary_text(bytes);
      break;
    case 13:
      load_vocabulary(bytes, false);
      break;
    case 14:
      load_vocabulary(bytes, true);
      break;
    case 15:
      s.open_with("folders", "times.txt", bytes);
      break;
    case 16:
      s.open_with("folders", "stereo.yaml", bytes);
      break;
    case 17:
      s.open_with("folders", "left/1.png", bytes);
      break;
    case 18:
      read_graph(bytes, [](std::istream& in) { return ft::read_g2o(in); });
      break;
    case 19:
      read_graph(bytes, [](std::istream& in) { return ft::read_g2o_similarities(in); });
      read_bundle(bytes);
      break;
    case 20:
      s.open_with("tum", "rgb.txt", bytes);
      break;
    case 21:
      s.open_with("tum", "associations.txt", bytes);
      break;
    case 22:
      s.open_with("tum", "camera.txt", bytes);
      break;
    case 23:
      s.open_with("tum", "depth/0.png", bytes);
      break;
    case 24:
      s.open_with("scenes", "frame-000001.pose.txt", bytes);
      break;
    case 25:
      s.open_with("raw", "image_00/timestamps.txt", bytes);
      break;
    case 26:
      s.open_with("raw", "calib_cam_to_cam.txt", bytes);
      break;
    case 27:
      s.open_with("raw", "oxts/data/0000000001.txt", bytes);
      break;
    default:
      read_settings(s.files(), bytes);
  }
  return 0;
}

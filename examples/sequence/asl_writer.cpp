// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/asl_writer.hpp"

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/parallel.hpp"

#include <filesystem>
#include <fstream>
#include <locale>
#include <mutex>
#include <system_error>

namespace seq {
namespace {

namespace fs = std::filesystem;

constexpr char const* marker = "generated.txt";

void make_folder(fs::path const& folder) {
  std::error_code code;
  fs::create_directories(folder, code);
  if (code) { throw error(folder.string() + ": cannot create the folder: " + code.message()); }
}

/// A text file with full double precision and no locale; close() must be called.
class text_file {
public:
  explicit text_file(fs::path const& path) : path_(path.string()), out_(path) {
    out_.imbue(std::locale::classic());
    out_.precision(17);
    check();
  }
  template <typename Value>
  text_file& operator<<(Value const& value) {
    out_ << value;
    return *this;
  }
  void close() {
    out_.close();
    check();
  }

private:
  void check() {
    if (!out_) { throw error(path_ + ": cannot write"); }
  }
  std::string path_;
  std::ofstream out_;
};

void write_transform(text_file& out, Eigen::Isometry3d const& T_body_sensor) {
  out << "# Sensor extrinsics wrt. the body-frame.\n"
         "T_BS:\n  cols: 4\n  rows: 4\n  data: [";
  Eigen::Matrix4d const& m = T_body_sensor.matrix();
  for (int i = 0; i < 16; ++i) {
    out << m(i / 4, i % 4) << (i == 15 ? "]\n" : (i % 4 == 3 ? ",\n         " : ", "));
  }
}

void write_camera(fs::path const& folder, char const* name, camera_intrinsics const& camera,
                  Eigen::Isometry3d const& T_body_camera, double fps) {
  text_file out(folder / "sensor.yaml");
  out << "%YAML:1.0\n# General sensor definitions.\nsensor_type: camera\ncomment: generated "
      << name << "\n\n";
  write_transform(out, T_body_camera);
  out << "\n# Camera specific definitions.\nrate_hz: " << fps << "\nresolution: [" << camera.width
      << ", " << camera.height << "]\ncamera_model: pinhole\nintrinsics: [" << camera.fx << ", "
      << camera.fy << ", " << camera.cx << ", " << camera.cy << "] #fu, fv, cu, cv\n";
  if (camera.model == lens::kannala_brandt) {
    auto const& k = camera.distortion;
    out << "distortion_model: equidistant\ndistortion_coefficients: [" << k[0] << ", " << k[1]
        << ", " << k[2] << ", " << k[3] << "]\n";
  } else {
    out << "distortion_model: radial-tangential\ndistortion_coefficients: [0.0, 0.0, 0.0, 0.0]\n";
  }
  if (camera.readout_s > 0) {
    out << "readout_s: " << camera.readout_s << " # rolling shutter, first row to last row\n";
  }
  out.close();
}

void write_camera_list(fs::path const& folder, generator const& source) {
  text_file out(folder / "data.csv");
  out << "#timestamp [ns],filename\n";
  for (int i = 0; i < source.size(); ++i) {
    if (source.dropped(i)) { continue; }
    out << source.time_ns(i) << "," << source.time_ns(i) << ".png\n";
  }
  out.close();
}

void write_imu(fs::path const& folder, generator const& source) {
  text_file sensor(folder / "sensor.yaml");
  sensor
      << "%YAML:1.0\n# General sensor definitions.\nsensor_type: imu\ncomment: generated imu0\n\n";
  write_transform(sensor, Eigen::Isometry3d::Identity());
  // Densities of 0 would be of no use to a filter.
  double const given = source.options().imu_noise_scale;
  double const scale = given > 0 ? given : 1.0;
  imu_noise const& noise = source.options().imu;
  sensor << "rate_hz: " << source.options().imu_rate
         << "\n\n# inertial sensor noise model parameters (static)\n"
         << "gyroscope_noise_density: " << scale * noise.gyro << " # [rad/s/sqrt(Hz)]\n"
         << "gyroscope_random_walk: " << scale * noise.gyro_walk << " # [rad/s^2/sqrt(Hz)]\n"
         << "accelerometer_noise_density: " << scale * noise.accel << " # [m/s^2/sqrt(Hz)]\n"
         << "accelerometer_random_walk: " << scale * noise.accel_walk << " # [m/s^3/sqrt(Hz)]\n";
  sensor.close();

  text_file out(folder / "data.csv");
  out << "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],"
         "a_RS_S_x [m s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2]\n";
  for (auto const& s : source.imu()) {
    out << s.time_ns;
    for (auto const* v : {&s.gyro, &s.accel}) {
      out << "," << v->x() << "," << v->y() << "," << v->z();
    }
    out << "\n";
  }
  out.close();
}

void write_truth(fs::path const& folder, generator const& source) {
  text_file sensor(folder / "sensor.yaml");
  sensor << "%YAML:1.0\n# General sensor definitions.\nsensor_type: visual-inertial\n"
            "comment: exact states of the generator\n\n";
  write_transform(sensor, Eigen::Isometry3d::Identity());
  sensor.close();

  text_file out(folder / "data.csv");
  out << "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], "
         "q_RS_z [], v_RS_R_x [m s^-1], v_RS_R_y [m s^-1], v_RS_R_z [m s^-1], b_w_RS_S_x [rad "
         "s^-1], "
         "b_w_RS_S_y [rad s^-1], b_w_RS_S_z [rad s^-1], b_a_RS_S_x [m s^-2], b_a_RS_S_y [m s^-2], "
         "b_a_RS_S_z [m s^-2]\n";
  for (auto const& s : source.body_ground_truth()) {
    Eigen::Vector3d const p = s.T_world_body.translation();
    Eigen::Quaterniond const q(s.T_world_body.linear());
    out << s.time_ns << "," << p.x() << "," << p.y() << "," << p.z() << "," << q.w() << "," << q.x()
        << "," << q.y() << "," << q.z();
    for (auto const* v : {&s.velocity, &s.gyro_bias, &s.accel_bias}) {
      out << "," << v->x() << "," << v->y() << "," << v->z();
    }
    out << "\n";
  }
  out.close();
}

void write_options(fs::path const& path, generator_options const& o) {
  text_file out(path);
  out << "# ft generated sequence; the same options give the same files\n"
      << "rig: " << (o.rig == rig_kind::fisheye ? "fisheye" : "pinhole") << "\nwidth: " << o.width
      << "\nheight: " << o.height << "\nframes: " << o.frames << "\nfps: " << o.fps
      << "\nseed: " << o.seed << "\nnoise_sigma: " << o.noise_sigma
      << "\nexposure_change: " << (o.exposure_change ? "true" : "false")
      << "\nvignetting: " << (o.vignetting ? "true" : "false") << "\nbaseline: " << o.baseline
      << "\nimu_rate: " << o.imu_rate << "\nimu_noise_scale: " << o.imu_noise_scale
      << "\nimu_noise: " << o.imu.gyro << " " << o.imu.accel << " " << o.imu.gyro_walk << " "
      << o.imu.accel_walk << "\ngyro_bias: " << o.gyro_bias << "\naccel_bias: " << o.accel_bias
      << "\nexposure_s: " << o.exposure_s << "\nreadout_s: " << o.readout_s
      << "\nscene: " << (o.scene == scene_kind::corridor ? "corridor" : "room")
      << "\nspeed: " << o.speed << "\nlook_aside: " << o.look_aside << "\nrepeat: " << o.repeat
      << "\nhiding: " << o.hiding.bonnet << " " << o.hiding.dirt << " " << o.hiding.companion << " "
      << o.hiding.crossing << " " << o.hiding.crossing_speed;
  for (auto const& s : o.blind) { out << "\nblind: " << s.from_s << " " << s.to_s; }
  for (auto const& s : o.dropped) { out << "\ndropped: " << s.from_s << " " << s.to_s; }
  for (auto const& f : o.fast_turns) {
    out << "\nfast_turn: " << f.when.from_s << " " << f.when.to_s << " " << f.degrees;
  }
  out << "\n";
  out.close();
}

void write_all(generator const& source, fs::path const& root, asl_options const& options,
               std::function<void(int)> const& progress) {
  write_options(root / marker, source.options());
  fs::path const mav = root / "mav0";
  fs::path const left = mav / "cam0";
  fs::path const right = mav / "cam1";
  fs::path const imu = mav / "imu0";
  fs::path const truth = mav / "state_groundtruth_estimate0";
  for (auto const& folder : {left / "data", right / "data", truth}) { make_folder(folder); }

  stereo_rig const& rig = source.rig();
  write_camera(left, "cam0", rig.left, rig.T_body_left, rig.fps);
  write_camera(right, "cam1", rig.right, rig.T_body_left * rig.T_left_right, rig.fps);
  if (options.imu) {
    make_folder(imu);
    write_imu(imu, source);
  }
  write_truth(truth, source);

  std::mutex guard;
  int done = 0;
  parallel_for(source.size(), options.threads, [&](int i) {
    if (!source.dropped(i)) {
      stereo_frame const frame = source.render(i);
      std::string const name = std::to_string(frame.time_ns) + ".png";
      write_png((left / "data" / name).string(), frame.left, options.png_compression);
      write_png((right / "data" / name).string(), frame.right, options.png_compression);
    }
    std::lock_guard<std::mutex> const lock(guard);
    ++done;
    if (progress) { progress(done); }
  });
  write_camera_list(right, source);
  write_camera_list(left, source);
}

}  // namespace

void write_asl(generator const& source, std::string const& directory, asl_options const& options,
               std::function<void(int done)> const& progress) {
  if (options.threads < 0 || options.threads > 256) {
    throw error("write_asl: threads is " + std::to_string(options.threads) +
                "; must be 1 to 256, or 0 for the default");
  }
  if (options.png_compression < 0 || options.png_compression > 9) {
    throw error("write_asl: png_compression is " + std::to_string(options.png_compression) +
                "; must be 0 to 9");
  }
  fs::path target = fs::path(directory).lexically_normal();
  if (!target.has_filename()) { target = target.parent_path(); }  // "name/"
  if (target.empty() || target.filename() == "." || target.filename() == ".." ||
      !target.has_filename()) {
    throw error("write_asl: '" + directory + "' cannot be created as a new folder");
  }
  fs::path partial = target;
  partial += ".partial";

  std::error_code code;
  if (fs::exists(fs::symlink_status(target, code))) {
    if (!fs::is_directory(target, code) || !fs::is_empty(target, code) || code) {
      throw error(target.string() + ": exists already; give a new name or remove it");
    }
  }
  if (fs::exists(fs::symlink_status(partial, code))) {
    if (!fs::is_regular_file(partial / marker, code)) {
      throw error(partial.string() + ": in the way, and not left by an interrupted generation");
    }
    fs::remove_all(partial, code);
    if (code) { throw error(partial.string() + ": cannot remove: " + code.message()); }
  }
  make_folder(partial);
  try {
    write_all(source, partial, options, progress);
    fs::rename(partial, target, code);  // replaces an empty folder
    if (code) { throw error(target.string() + ": cannot rename to it: " + code.message()); }
  } catch (...) {
    fs::remove_all(partial, code);
    throw;
  }
}

}  // namespace seq

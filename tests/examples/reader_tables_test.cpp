// SPDX-License-Identifier: Apache-2.0
/// @file Tables and lists as people's programs write them: separators, headings, columns by name,
/// lines that are cut or not finite, a locale with a decimal comma.
#include <gtest/gtest.h>

#include <algorithm>
#include <clocale>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <string>
#include <vector>

#include "examples/sequence/evaluation.hpp"
#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "tests/support/sequence.hpp"

namespace reader_tables_test {

namespace fs = std::filesystem;
using seq_test::contains;
using seq_test::message_of;
using seq_test::replaced;
using seq_test::temp_folder;

std::string const camera_text =
    "%YAML:1.0\nT_BS:\n  cols: 4\n  rows: 4\n"
    "  data: [1, 0, 0, X, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\nrate_hz: 20\n"
    "resolution: [64, 48]\ncamera_model: pinhole\nintrinsics: [40.5, 40.5, 31.5, 23.5]\n"
    "distortion_model: radial-tangential\ndistortion_coefficients: [0, 0, 0, 0]\n";

void put(temp_folder const& folder, std::string const& name) {
  fs::create_directories(fs::path(folder.path(name)).parent_path());
  seq::write_png(folder.path(name), {64, 48, std::vector<std::uint8_t>(64 * 48, 40)});
}

/// A pair in EuRoC's layout, of three frames. @param csv of each camera
void write_pair(temp_folder const& folder, std::string const& csv) {
  for (std::string const name : {"mav0/cam0/", "mav0/cam1/"}) {
    folder.write(name + "data.csv", csv);
    folder.write(name + "sensor.yaml", replaced(camera_text, "X", name[8] == '1' ? "0.1" : "0"));
    for (char const* file : {"a.png", "b.png", "c.png"}) { put(folder, name + "data/" + file); }
  }
}

std::string const plain = "1000000000,a.png\n1050000000,b.png\n1100000000,c.png\n";

std::string with_all(std::string text, char from, std::string const& to) {
  for (std::size_t at = 0; (at = text.find(from, at)) != std::string::npos; at += to.size()) {
    text.replace(at, 1, to);
  }
  return text;
}

bool said(std::vector<std::string> const& warnings, std::string const& part) {
  for (std::string const& warning : warnings) {
    if (contains(warning, part)) { return true; }
  }
  return false;
}

TEST(reader_tables, separators_and_headings_are_found) {
  for (std::string const& csv :
       {plain, "#timestamp [ns],filename\n" + plain, "timestamp,filename\n" + plain,
        "\"timestamp\",\"filename\"\n" + replaced(plain, "a.png", "\"a.png\""),
        "time;name\n" + replaced(replaced(replaced(plain, ",a", ";a"), ",b", "; b"), ",c", ";c"),
        replaced(replaced(replaced(plain, ",a", "\ta"), ",b", "\tb"), ",c", "\tc"),
        replaced(replaced(replaced(plain, ",a", "  a"), ",b", " b"), ",c", " c"),
        replaced(replaced(replaced(plain, "a.png", "a.png,0.01"), "b.png", "b.png,0.01"), "c.png",
                 "c.png,0.01")}) {
    temp_folder const folder;
    write_pair(folder, csv);
    seq::sequence const s = seq::sequence::open(folder.path());
    EXPECT_EQ(s.size(), 3) << csv;
    EXPECT_TRUE(s.warnings().empty()) << csv;
  }
  temp_folder const folder;
  write_pair(folder, plain + "soon,d.png\n");
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path()); }),
                       "data.csv:4: 'soon' is not a time"));
}

TEST(reader_tables, listed_images_of_a_pair_that_are_not_there_are_counted) {
  temp_folder const folder;
  write_pair(folder, plain);
  fs::remove(folder.path("mav0/cam0/data/b.png"));
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.size(), 2);
  EXPECT_TRUE(said(s.warnings(), "cam0: 1 of the listed images are not there"));
  EXPECT_FALSE(said(s.warnings(), "cam1: "));
}

TEST(reader_tables, images_of_half_the_size_ask_for_a_scaled_calibration) {
  temp_folder const folder;
  write_pair(folder, plain);
  seq::write_png(folder.path("mav0/cam0/data/a.png"), {32, 24, std::vector<std::uint8_t>(768, 4)});
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path()); }),
                       "scale fx, fy, cx, cy with the images"));
}

TEST(reader_tables, columns_of_an_imu_go_by_their_names) {
  temp_folder const folder;
  std::vector<std::string> warnings;
  auto const first = [&](std::string const& text) {
    warnings.clear();
    return seq::read_imu_samples(folder.write("imu.csv", text), &warnings).front();
  };
  Eigen::Vector3d const gyro(1, 2, 3), accel(7, 8, 9);
  std::string const usual = "1000000000,1,2,3,7,8,9,25\n";
  for (char const* heading :
       {"", "timestamp,omega_x,omega_y,omega_z,alpha_x,alpha_y,alpha_z,temperature\n",
        "#timestamp [ns],w_RS_S_x [rad s^-1],w_RS_S_y [rad s^-1],w_RS_S_z [rad s^-1],a_RS_S_x [m "
        "s^-2],a_RS_S_y [m s^-2],a_RS_S_z [m s^-2],t\n",
        "time,one,two,three,four,five,six,seven\n", "acc before gyro\n"}) {
    auto const sample = first(heading + usual);
    EXPECT_EQ(sample.gyro, gyro) << heading;
    EXPECT_EQ(sample.accel, accel) << heading;
    EXPECT_TRUE(warnings.empty()) << heading;
  }
  for (char const* heading :
       {"timestamp,ax,ay,az,gx,gy,gz\n", "#t [ns],a_x,a_y,a_z,w_x,w_y,w_z\n",
        "Time;AccX (m/s^2);AccY;AccZ;GyroX (rad/s);GyroY;GyroZ\n",
        "%time,field.linear_acceleration.x,field.linear_acceleration.y,"
        "field.linear_acceleration.z,field.angular_velocity.x,field.angular_velocity.y,"
        "field.angular_velocity.z\n"}) {
    bool const semicolons = contains(heading, ";");
    auto const sample = first(heading + std::string(semicolons ? "1000000000;7;8;9;1;2;3\n"
                                                               : "1000000000,7,8,9,1,2,3\n"));
    EXPECT_EQ(sample.gyro, gyro) << heading;
    EXPECT_EQ(sample.accel, accel) << heading;
    EXPECT_TRUE(said(warnings, "columns are taken by the names")) << heading;
  }
  auto const ros = first(
      "%time,field.header.seq,field.orientation.x,field.orientation.y,field.orientation.z,"
      "field.orientation.w,field.angular_velocity.x,field.angular_velocity.y,"
      "field.angular_velocity.z,field.linear_acceleration.x,field.linear_acceleration.y,"
      "field.linear_acceleration.z\n1000000000,4,0,0,0,1,1,2,3,7,8,9\n");
  EXPECT_EQ(ros.gyro, gyro);
  EXPECT_EQ(ros.accel, accel);
  std::string const short_line =
      "t,u,ax,ay,az,gx,gy,gz\n1,0,7,8,9,1,2,3\n2,0,7,8,9,1,2\n3,0,7,8,9,1,2,3\n";
  EXPECT_TRUE(contains(message_of([&] { first(short_line); }), "imu.csv:3: 7 fields, must have 8"));
}

TEST(reader_tables, headings_that_look_otherwise_than_the_records) {
  temp_folder const folder;
  std::string const rows = "1000000000,7,8,9,1,2,3\n1005000000,7,8,9,1,2,3\n";
  std::string const names = "time,a_x [m s^-2],a_y [m s^-2],a_z [m s^-2],w_x,w_y,w_z";
  for (std::string const& text :
       {names + "\n" + replaced(replaced(rows, "3\n1", "3,\n1"), "3\n", "3,\n"),
        with_all(names, ',', ";") + "\n" + rows,
        with_all(names, ',', "  ") + "\n" + with_all(rows, ',', " "),
        "# " + names + "\n# recorded today, by hand\n" + rows}) {
    std::vector<std::string> warnings;
    auto const samples = seq::read_imu_samples(folder.write("imu.csv", text), &warnings);
    ASSERT_EQ(samples.size(), 2U) << text;
    EXPECT_EQ(samples[0].gyro, Eigen::Vector3d(1, 2, 3)) << text;
    EXPECT_TRUE(said(warnings, "by the names of the heading: 5 6 7 2 3 4")) << text;
  }
  std::vector<std::string> warnings;
  std::string const twice = replaced(names, "time,", "time,acc_x,");
  seq::read_imu_samples(folder.write("imu.csv", twice + "\n" + replaced(rows, "000,7", "000,0,7")),
                        &warnings);
  EXPECT_TRUE(said(warnings, "in another order, or twice; they are taken in EuRoC's: 2 3 4 5 6 7"));
  warnings.clear();
  std::string const damaged = folder.write("imu.csv", names + "\nsoon,7,8,9,1,2,3\n" + rows);
  EXPECT_EQ(seq::read_imu_samples(damaged, &warnings).size(), 2U);
  EXPECT_TRUE(said(warnings, "imu.csv:2: begins with no number, and is left out"));
}

TEST(reader_tables, samples_that_are_not_finite_or_cut_are_left_out) {
  temp_folder const folder;
  std::vector<std::string> warnings;
  std::string const row = ",0.1,0.2,0.3,7,8,9\n";
  std::string const file =
      folder.write("imu.csv", "1000000000" + row + "1005000000,nan,0,0,0,0,0\n1010000000" + row +
                                  "1015000000,0.1,0.");
  EXPECT_EQ(seq::read_imu_samples(file, &warnings).size(), 2U);
  EXPECT_TRUE(said(warnings, "1 of 3 samples left out: not finite (the first is in line 2)"));
  EXPECT_TRUE(said(warnings, "the last line is cut, and left out"));
  std::string const wide = "1000000000,0.1,0.2,0.3,7,8,9,20\n1005000000,0.1,0.2,0.3,7,8,9";
  std::string const other = folder.write("wide.csv", wide);
  EXPECT_EQ(seq::read_imu_samples(other).size(), 1U) << "the last number may be cut";
  folder.write("wide.csv", wide + "\n");
  EXPECT_EQ(seq::read_imu_samples(other).size(), 2U) << "only a further column is missing";
}

TEST(reader_tables, truth_that_a_tracker_had_lost_is_left_out) {
  temp_folder const folder;
  write_pair(folder, plain);
  std::string const pose = ",1,2,3,1,0,0,0\n";
  folder.write("mav0/mocap0/data.csv", "time,x,y,z,qw,qx,qy,qz\n1000000000" + pose +
                                           "1010000000,0,0,0,0,0,0,0\n1020000000,nan,0,0,1,0,0,0\n"
                                           "1100000000" +
                                           pose);
  seq::sequence const s = seq::sequence::open(folder.path());
  EXPECT_EQ(s.ground_truth().size(), 2U);
  EXPECT_TRUE(said(s.warnings(), "mocap0/data.csv: 2 of 4 poses left out"));
  std::vector<std::string> warnings;
  std::string const tum =
      folder.write("poses.txt", "1 0 0 0 0 0 0 1\n2 nan 0 0 0 0 0 1\n3 0 0 0 0 0 0 0\n");
  EXPECT_EQ(seq::read_tum(tum, &warnings).size(), 1U);
  EXPECT_TRUE(said(warnings, "poses.txt: 2 of 3 poses left out"));
  EXPECT_TRUE(
      contains(message_of([&] { seq::read_tum(tum); }), "poses.txt:2: 'nan' is not finite"));
  folder.write("poses.txt", "1 0 0 0 0 0 0 0.5\n");
  EXPECT_TRUE(contains(message_of([&] { seq::read_tum(tum, &warnings); }), "quaternion norm"));
}

TEST(reader_tables, an_imu_that_cannot_be_read_can_be_switched_off) {
  temp_folder const folder;
  write_pair(folder, plain);
  folder.write("mav0/imu0/sensor.yaml",
               "T_BS:\n  cols: 4\n  rows: 4\n"
               "  data: [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]\nrate_hz: 200\n"
               "gyroscope_noise_density: 1e-4\ngyroscope_random_walk: 2e-5\n"
               "accelerometer_noise_density: 2e-3\naccelerometer_random_walk: 3e-3\n");
  folder.write("mav0/imu0/data.csv", "");
  seq::open_options options;
  options.read_imu = true;
  EXPECT_TRUE(contains(message_of([&] { seq::sequence::open(folder.path(), options); }),
                       "data.csv: no samples; --imu off"));
}

TEST(reader_tables, times_may_have_a_heading_and_a_shutter_is_described) {
  temp_folder const folder;
  for (char const* name : {"images/0.png", "images/1.png", "images/2.png"}) { put(folder, name); }
  folder.write("images/times.txt", "seconds\n0.5\n0.6\n0.7\n");
  folder.write("camchain.yaml",
               "cam0:\n  camera_model: pinhole\n  intrinsics: [40, 40, 31.5, 23.5]\n"
               "  distortion_model: none\n  distortion_coeffs: []\n  resolution: [64, 48]\n"
               "  line_delay: 0.0005\n");
  seq::sequence const s = seq::sequence::open(folder.path());
  ASSERT_EQ(s.size(), 3);
  EXPECT_EQ(s.time_ns(2), 700'000'000);
  EXPECT_TRUE(contains(seq::describe(s)[1].text, "rolling shutter of 23.5 ms"));
}

/// Programs with Qt or GTK set the locale that the system asks for, and so may those of Python.
TEST(reader_tables, numbers_have_points_in_a_locale_of_commas) {
  temp_folder const folder;
  write_pair(folder, "1.00,a.png\n1.05,b.png\n1.10,c.png\n");
  struct c_locale {
    ~c_locale() { std::setlocale(LC_NUMERIC, "C"); }
  } const at_the_end;
  char const* const names[] = {"de_DE.UTF-8", "de_DE.utf8", "fr_FR.UTF-8", "es_ES.UTF-8"};
  if (std::none_of(std::begin(names), std::end(names),
                   [](char const* name) { return std::setlocale(LC_NUMERIC, name) != nullptr; })) {
    GTEST_SKIP() << "no locale with decimal commas is installed";
  }
  std::string const file = folder.path("poses.txt");
  seq::stamped_pose pose;
  pose.time_ns = 1'500'000'000;
  pose.T_world_camera = Eigen::Translation3d(0.25, -1.5, 2);
  EXPECT_NO_THROW(EXPECT_EQ(seq::sequence::open(folder.path()).time_ns(1), 1'050'000'000));
  seq::write_tum(file, {pose});
  EXPECT_NO_THROW(EXPECT_EQ(seq::read_tum(file)[0].T_world_camera.translation().x(), 0.25));
  folder.write("poses.txt", "1,5 0 0 0 0 0 0 1\n");
  EXPECT_TRUE(contains(message_of([&] { seq::read_tum(file); }), "not a time in seconds"));
  seq::write_kitti_poses(file, {pose});
  std::ifstream in(file);
  std::string const written{std::istreambuf_iterator<char>(in), {}};
  EXPECT_EQ(written.find(','), std::string::npos) << written;
  EXPECT_TRUE(contains(written, "2.500000000e-01")) << written;
}

}  // namespace reader_tables_test

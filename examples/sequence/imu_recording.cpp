// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
#include "examples/sequence/detail/table.hpp"
#include "examples/sequence/detail/text.hpp"

namespace seq {
namespace {

using detail::to_text;

constexpr std::int64_t finest_sample_step_ns = 50'000;
constexpr double gravity = 9.81;  // m/s^2

double median_length(std::vector<imu_sample> const& samples, Eigen::Vector3d imu_sample::*of) {
  std::vector<double> lengths;
  for (imu_sample const& s : samples) { lengths.push_back((s.*of).norm()); }
  return detail::median(std::move(lengths));
}

/// 0 to 2 for x, y, z of a gyroscope, 3 to 5 of an accelerometer, -1 for another column. Names are
/// such as w_RS_S_x, omega_x, gx, GyroX, angular_velocity.x; a_RS_S_x, alpha_x (Kalibr's), ax,
/// accX.
int quantity_of(std::string name) {
  std::transform(name.begin(), name.end(), name.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  if (name.size() < 2 || name.back() < 'x' || name.back() > 'z') { return -1; }
  int const axis = name.back() - 'x';
  name.pop_back();
  auto const has = [&](char const* part) { return name.find(part) != std::string::npos; };
  if (has("bias") || has("cov") || has("angular_acc")) { return -1; }
  bool const letter = name.size() == 1 || name[1] == '_' || name[1] == '.' || name[1] == ' ';
  if (has("gyr") || has("omega") || has("angular_vel")) { return axis; }
  if (has("acc") || has("alpha")) { return 3 + axis; }
  if (letter && (name[0] == 'w' || name[0] == 'g')) { return axis; }
  return letter && name[0] == 'a' ? 3 + axis : -1;
}

/// The columns of angular rates and accelerations: those that the heading names, or EuRoC's.
std::array<std::size_t, 6> columns_of(detail::table const& table, std::string const& path,
                                      std::vector<std::string>& warnings) {
  std::array<std::size_t, 6> const usual = {1, 2, 3, 4, 5, 6};
  std::array<std::size_t, 6> named{};  // the time stamp is in column 0
  bool twice = false, elsewhere = false;
  for (std::size_t c = 1; c < table.names.size(); ++c) {
    int const quantity = quantity_of(table.names[c]);
    if (quantity < 0) { continue; }
    std::size_t& column = named[static_cast<std::size_t>(quantity)];
    twice = twice || column != 0;
    elsewhere = elsewhere || c != usual[static_cast<std::size_t>(quantity)];
    column = c;
  }
  if (!elsewhere) { return usual; }
  bool const all = std::find(named.begin(), named.end(), std::size_t{0}) == named.end();
  std::array<std::size_t, 6> const taken = all && !twice ? named : usual;
  std::string columns;
  for (std::size_t const c : taken) { columns += " " + std::to_string(c + 1); }
  warnings.push_back(path +
                     (taken == named ? ": columns are taken by the names of the heading:"
                                     : ": the heading names columns in another order, or twice; "
                                       "they are taken in EuRoC's:") +
                     columns + " (angular rates x y z, accelerations x y z)");
  return taken;
}

}  // namespace

std::vector<imu_sample> read_imu_samples(std::string const& path,
                                         std::vector<std::string>* warnings) {
  std::vector<std::string> ignored;
  std::vector<std::string>& said = warnings != nullptr ? *warnings : ignored;
  detail::table const table =
      detail::read_table(path, 7, "time stamp, angular rates, accelerations", said);
  std::array<std::size_t, 6> const columns = columns_of(table, path, said);
  std::size_t const least = *std::max_element(columns.begin(), columns.end()) + 1;
  detail::stamp_column stamps(path, finest_sample_step_ns);
  std::vector<imu_sample> read;
  int first_broken = 0, broken = 0;
  for (detail::table_row const& row : table.rows) {
    if (row.fields.size() < least) {
      detail::fail_at(
          path, row.line,
          std::to_string(row.fields.size()) + " fields, must have " + std::to_string(least));
    }
    double v[6];
    bool finite = true;
    for (std::size_t i = 0; i < 6; ++i) {
      v[i] = detail::number(row.fields[columns[i]], path, row.line);
      finite = finite && std::isfinite(v[i]);
    }
    if (!finite) {
      if (broken++ == 0) { first_broken = row.line; }
      continue;
    }
    stamps.add(row.fields[0], row.line);
    read.push_back({0, {v[0], v[1], v[2]}, {v[3], v[4], v[5]}});
  }
  if (broken > 0) {
    said.push_back(path + ": " + std::to_string(broken) + " of " +
                   std::to_string(table.rows.size()) +
                   " samples left out: not finite (the first is in line " +
                   std::to_string(first_broken) + ")");
  }
  if (read.empty()) { throw error(path + ": no samples"); }
  std::vector<std::int64_t> const times = stamps.times_ns(said);
  std::vector<imu_sample> samples;
  for (std::size_t const i :
       detail::ordered_lines(times, detail::disordered::left_out, path, "samples", said)) {
    samples.push_back({times[i], read[i].gyro, read[i].accel});
  }
  return samples;
}

namespace detail {

void check_imu(imu_recording const& imu, std::string const& path,
               std::vector<std::string>& warnings) {
  constexpr std::size_t enough = 20;  // fewer tell no median
  if (imu.samples.size() < enough) { return; }
  std::vector<std::int64_t> times;
  for (imu_sample const& s : imu.samples) { times.push_back(s.time_ns); }
  double const measured = 1e9 / static_cast<double>(median_step(times));
  double const said = imu.calibration.rate_hz;
  if (!(measured < 1.2 * said && said < 1.2 * measured)) {
    warnings.push_back(path + ": samples come at " + to_text(measured) + " Hz, rate_hz says " +
                       to_text(said) + ": the noise of a sample is not what it is taken for");
  }
  double const force = median_length(imu.samples, &imu_sample::accel);
  if (force < 0.5 * gravity || force > 2 * gravity) {
    bool const in_g = force > 0.5 && force < 2;
    warnings.push_back(path + ": the accelerometer measures " + to_text(force) +
                       " m/s^2 in the median, gravity alone is " + to_text(gravity) +
                       (in_g ? ": is it in g?" : ": is it in m/s^2, with gravity?"));
  }
  constexpr double fastest = 3;  // rad/s, in the median
  double const turn = median_length(imu.samples, &imu_sample::gyro);
  if (turn > fastest) {
    warnings.push_back(path + ": the gyroscope measures " + to_text(turn) +
                       " rad/s in the median, more than " + to_text(fastest) +
                       ": is it in degrees per second?");
  }
}

}  // namespace detail
}  // namespace seq

// SPDX-License-Identifier: Apache-2.0
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/detail/layout.hpp"
#include "examples/sequence/detail/stamps.hpp"
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

}  // namespace

std::vector<imu_sample> read_imu_samples(std::string const& path,
                                         std::vector<std::string>* warnings) {
  detail::stamp_column stamps(path, finest_sample_step_ns);
  std::vector<imu_sample> read;
  for (detail::text_line const& line : detail::read_lines(path)) {
    if (detail::is_blank_or_comment(line.text)) { continue; }
    std::vector<std::string> const fields = detail::split(line.text, ",", false);
    if (fields.size() < 7) {
      detail::fail_at(path, line.number,
                      std::to_string(fields.size()) + " fields, must have at least 7");
    }
    imu_sample s;
    stamps.add(fields[0], line.number);
    for (int i = 0; i < 3; ++i) {
      auto const k = static_cast<std::size_t>(i);
      s.gyro[i] = detail::finite_number(fields[1 + k], path, line.number);
      s.accel[i] = detail::finite_number(fields[4 + k], path, line.number);
    }
    read.push_back(s);
  }
  if (read.empty()) { throw error(path + ": no samples"); }
  std::vector<std::string> ignored;
  std::vector<std::string>& said = warnings != nullptr ? *warnings : ignored;
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

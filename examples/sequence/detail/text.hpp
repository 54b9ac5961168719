// SPDX-License-Identifier: Apache-2.0
/// @file Lines and numbers of text files, with errors that name file and line. Not API.
#pragma once

#include <algorithm>
#include <clocale>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <limits>
#include <string>
#include <system_error>
#include <utility>
#include <vector>

#include "examples/sequence/types.hpp"

namespace seq::detail {

/// A line of a text file, without its line ending.
struct text_line {
  int number = 0;  ///< from 1
  std::string text;
  bool ends = true;  ///< with a line break
};

inline bool is_digit(char c) { return c >= '0' && c <= '9'; }

/// @throws seq::error "file:line: reason"
[[noreturn]] inline void fail_at(std::string const& path, int line, std::string const& reason) {
  throw error(path + ":" + std::to_string(line) + ": " + reason);
}

/// Shortest text that shows a double to six significant digits, for messages.
inline std::string to_text(double value) {
  char buffer[32];
  std::snprintf(buffer, sizeof buffer, "%g", value);
  return buffer;
}

/// `word` as strtod and strtold read it in the program's locale, which may have a decimal comma. A
/// comma in the word ends the number there in any locale.
inline std::string with_decimal_point(std::string word) {
  std::string const point = std::localeconv()->decimal_point;
  if (point == ".") { return word; }
  std::replace(word.begin(), word.end(), ',', ';');
  std::size_t const at = word.find('.');
  return at == std::string::npos ? word : word.replace(at, 1, point);
}

inline bool is_file(std::string const& path) {
  std::error_code ignored;
  return std::filesystem::is_regular_file(path, ignored);
}

inline bool is_directory(std::string const& path) {
  std::error_code ignored;
  return std::filesystem::is_directory(path, ignored);
}

/// All lines of a text file; a byte order mark and carriage returns are removed.
/// @throws seq::error when the file is missing, not a plain file, or cannot be read
inline std::vector<text_line> read_lines(std::string const& path) {
  if (!is_file(path)) { throw error(path + ": no such file"); }
  std::ifstream in(path, std::ios::binary);
  if (!in) { throw error(path + ": cannot be opened"); }
  std::vector<text_line> lines;
  std::string text;
  while (std::getline(in, text)) {
    if (lines.empty() && text.compare(0, 3, "\xEF\xBB\xBF") == 0) { text.erase(0, 3); }
    if (!text.empty() && text.back() == '\r') { text.pop_back(); }
    lines.push_back({static_cast<int>(lines.size()) + 1, text, !in.eof()});
  }
  if (in.bad()) { throw error(path + ": cannot be read"); }
  return lines;
}

/// True for a line that is empty, or a comment starting with #.
inline bool is_blank_or_comment(std::string const& text) {
  std::size_t const first = text.find_first_not_of(" \t");
  return first == std::string::npos || text[first] == '#';
}

/// Headings of tables do not.
inline bool begins_with_number(std::string const& text) {
  std::size_t const first = text.find_first_not_of(" \t\"+-.");
  return first != std::string::npos && is_digit(text[first]);
}

/// The parts of `text` between any of `separators`; with `merge`, consecutive separators count as
/// one.
inline std::vector<std::string> split(std::string const& text, char const* separators, bool merge) {
  std::vector<std::string> parts;
  std::size_t begin = 0;
  while (begin <= text.size()) {
    std::size_t const found = text.find_first_of(separators, begin);
    std::size_t const end = found == std::string::npos ? text.size() : found;
    if (!merge || end > begin) { parts.push_back(text.substr(begin, end - begin)); }
    begin = end + 1;
  }
  return parts;
}

/// `text` without blanks at both ends.
inline std::string trim(std::string const& text) {
  std::size_t const first = text.find_first_not_of(" \t\r\n");
  if (first == std::string::npos) { return {}; }
  return text.substr(first, text.find_last_not_of(" \t\r\n") - first + 1);
}

/// Reads the whole of `text` as a number. @return false if it is not one (NaN and infinity are)
inline bool to_number(std::string const& text, double& value) {
  std::string const word = with_decimal_point(trim(text));
  char* end = nullptr;
  value = std::strtod(word.c_str(), &end);
  return !word.empty() && end == word.c_str() + word.size();
}

/// @throws seq::error naming file and line when `text` is not a number (NaN and infinity are)
inline double number(std::string const& text, std::string const& path, int line) {
  double value = 0;
  if (!to_number(text, value)) { fail_at(path, line, "'" + trim(text) + "' is not a number"); }
  return value;
}

/// @throws seq::error naming file and line when `text` is not a finite number
inline double finite_number(std::string const& text, std::string const& path, int line) {
  double const value = number(text, path, line);
  if (!std::isfinite(value)) { fail_at(path, line, "'" + trim(text) + "' is not finite"); }
  return value;
}

/// Non-negative whole nanoseconds. @throws seq::error naming file and line
inline std::int64_t nanoseconds(std::string const& text, std::string const& path, int line) {
  std::string const word = trim(text);
  bool valid = !word.empty() && word.size() <= 19;
  std::int64_t value = 0;
  for (char const c : word) {
    valid = valid && c >= '0' && c <= '9';
    if (!valid) { break; }
    int const digit = c - '0';
    valid = value <= (std::numeric_limits<std::int64_t>::max() - digit) / 10;
    value = valid ? value * 10 + digit : value;
  }
  if (!valid) { fail_at(path, line, "'" + word + "' is not a time stamp in whole nanoseconds"); }
  return value;
}

/// Seconds, as nanoseconds. @throws seq::error naming file and line: not a number, or beyond
/// +-4.6e9 s, so that no difference of two overflows
inline std::int64_t seconds_to_ns(std::string const& text, std::string const& path, int line) {
  std::string const word = with_decimal_point(trim(text));
  char* end = nullptr;
  // long double: seconds since 1970 with nine decimals need more digits than a double has.
  long double const seconds = std::strtold(word.c_str(), &end);
  if (word.empty() || end != word.c_str() + word.size()) {
    fail_at(path, line, "'" + word + "' is not a time in seconds");
  }
  if (!(std::fabs(seconds) <= 4.6e9L)) {
    fail_at(path, line,
            "time " + word +
                " is beyond the limit of 4.6e9 seconds: milli-, micro- or nanoseconds? Seconds are "
                "expected");
  }
  return static_cast<std::int64_t>(std::llroundl(seconds * 1e9L));
}

/// Rotation from quaternion parts. @throws seq::error naming file and line unless the norm is near
/// 1
inline Eigen::Quaterniond unit_quaternion(double w, double x, double y, double z,
                                          std::string const& path, int line) {
  Eigen::Quaterniond q(w, x, y, z);
  double const norm = q.norm();
  if (!(std::fabs(norm - 1.0) <= 0.02)) {
    fail_at(path, line, "quaternion norm is " + to_text(norm) + ", 0.98 to 1.02 allowed");
  }
  q.normalize();
  return q;
}

/// Where a quaternion's real part is.
enum class quaternion_order { w_first, w_last };

/// Whether a tracker that had lost its body wrote the seven fields of a pose: numbers that are not
/// finite, or a quaternion of zeros.
inline bool is_no_pose(std::string const* fields) {
  double v[7] = {};
  bool finite = true;
  for (int i = 0; i < 7; ++i) {
    if (!to_number(fields[i], v[i])) { return false; }
    finite = finite && std::isfinite(v[i]);
  }
  return !finite || std::fabs(v[3]) + std::fabs(v[4]) + std::fabs(v[5]) + std::fabs(v[6]) <= 0;
}

/// Says how many were left out.
inline void say_no_poses(std::string const& path, std::size_t left_out, std::size_t of,
                         std::vector<std::string>& warnings) {
  if (left_out == 0) { return; }
  warnings.push_back(path + ": " + std::to_string(left_out) + " of " + std::to_string(of) +
                     " poses left out, which are not finite or whose quaternion is 0");
}

/// A pose from seven fields: position, then a unit quaternion. @throws seq::error naming file and
/// line
inline Eigen::Isometry3d pose_of_fields(std::string const* fields, quaternion_order order,
                                        std::string const& path, int line) {
  double v[7];
  for (int i = 0; i < 7; ++i) { v[i] = finite_number(fields[i], path, line); }
  double const* const q = v + 3;
  Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
  pose.translation() = Eigen::Vector3d(v[0], v[1], v[2]);
  pose.linear() =
      (order == quaternion_order::w_first ? unit_quaternion(q[0], q[1], q[2], q[3], path, line)
                                          : unit_quaternion(q[3], q[0], q[1], q[2], path, line))
          .toRotationMatrix();
  return pose;
}

}  // namespace seq::detail

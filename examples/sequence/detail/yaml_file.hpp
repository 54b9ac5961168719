// SPDX-License-Identifier: Apache-2.0
/// @file Calibration files in YAML, with checked access. Not API.
#pragma once

#include <yaml-cpp/yaml.h>

#include <cstddef>
#include <set>
#include <string>
#include <utility>
#include <vector>

#include "examples/sequence/detail/calibration_checks.hpp"
#include "examples/sequence/types.hpp"

namespace seq::detail {

/// A key that is not there: the file may be another program's.
struct missing_key : error {
  using error::error;
};

/// A YAML, JSON or OpenCV XML file whose top level is a map. OpenCV's dialect is read as OpenCV
/// reads it: a first line
/// `%YAML:1.0` or `YAML:1.0`, `key:value` without a blank, and a comment right after a value
/// (`30#fps`). All functions throw seq::error that names file, key, value and limit.
class yaml_file {
public:
  /// @throws seq::error also for a key that is given twice with two values
  explicit yaml_file(std::string const& path);
  /// The map at `key`, or its item of that index; messages name it after the path.
  yaml_file part(std::string const& key) const;
  yaml_file part(std::string const& key, std::size_t index) const;

  std::string const& path() const { return path_; }
  bool has(std::string const& key) const;

  /// @throws seq::error if missing, not a number, not finite or out of range
  double number(std::string const& key, limits const& range) const;
  double number_or(std::string const& key, limits const& range, double otherwise) const {
    return has(key) ? number(key, range) : otherwise;
  }
  /// A whole number, in any format ("20", "20.0", "2e1").
  int integer(std::string const& key, limits const& range) const;
  std::string text(std::string const& key) const;
  std::string text_or(std::string const& key, char const* otherwise) const {
    return has(key) ? text(key) : otherwise;
  }
  bool is_map(std::string const& key) const { return has(key) && find(key).IsMap(); }
  bool is_list(std::string const& key) const { return has(key) && find(key).IsSequence(); }
  /// A sequence of numbers, each within `range`.
  std::vector<double> list(std::string const& key, limits const& range) const;
  /// The numbers of an OpenCV matrix (rows, cols, data), of a list of rows, or of a plain list,
  /// which is a row.
  std::vector<double> matrix(std::string const& key, int& rows, int& cols) const;
  /// As above with a fixed shape.
  std::vector<double> matrix_of(std::string const& key, int rows, int cols) const;
  /// A 4x4, or 3x4, rigid transform.
  Eigen::Isometry3d transform(std::string const& key) const;

  /// Says that the program knows the key and has no use for it.
  void skip(std::string const& key) const { asked_.insert(key); }
  /// Keys of the file that nothing asked for, in the file's order.
  std::vector<std::string> unread() const;

private:
  yaml_file(std::string path, YAML::Node root) : path_(std::move(path)), root_(std::move(root)) {}
  /// @throws seq::error for a key that is given twice with two values
  void check_map() const;
  YAML::Node find(std::string const& key) const;
  YAML::Node required(std::string const& key) const;
  double to_checked(YAML::Node const& node, std::string const& key, limits const& range) const;
  std::vector<double> to_list(YAML::Node const& node, std::string const& key,
                              limits const& range) const;
  int dimension(YAML::Node const& node, std::string const& key, std::string const& name) const;

  std::string path_;
  YAML::Node root_;
  mutable std::set<std::string> asked_;
};

/// The content of an XML file of OpenCV's FileStorage as the YAML that it stands for.
/// @param text of the file @throws seq::error naming path and line
YAML::Node read_opencv_xml(std::string const& text, std::string const& path);

}  // namespace seq::detail

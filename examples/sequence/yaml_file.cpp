// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/detail/yaml_file.hpp"

#include <cctype>
#include <cmath>
#include <map>

#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

bool is_key_start(char c) { return std::isalpha(static_cast<unsigned char>(c)) != 0 || c == '_'; }

/// Puts a blank after the colon of `key:value`.
std::string with_blank_after_key(std::string const& line) {
  std::size_t const first = line.find_first_not_of(' ');
  if (first == std::string::npos || !is_key_start(line[first])) { return line; }
  std::size_t const colon = line.find(':', first);
  if (colon == std::string::npos || colon + 1 >= line.size()) { return line; }
  if (line.find_first_of(" \"'[{#", first) < colon) { return line; }
  if (line[colon + 1] == ' ' || line[colon + 1] == '\t') { return line; }
  return line.substr(0, colon + 1) + " " + line.substr(colon + 1);
}

/// Puts a blank before the # of a comment that follows a number, a bracket or a quote at once.
std::string with_blank_before_comment(std::string const& line) {
  char quote = 0;
  for (std::size_t i = 0; i < line.size(); ++i) {
    char const c = line[i];
    if (quote != 0) {
      if (c == '\\' && quote == '"') {
        ++i;
      } else if (c == quote) {
        quote = 0;
      }
      continue;
    }
    if (c == '"' || c == '\'') {
      quote = c;
    } else if (c == '#' && i > 0) {
      char const before = line[i - 1];
      bool const ends =
          is_digit(before) || before == '.' || before == ']' || before == '"' || before == '\'';
      return ends ? line.substr(0, i) + " " + line.substr(i) : line;
    }
  }
  return line;
}

/// OpenCV's dialect in plain YAML, with as many lines.
std::string plain_yaml(std::string const& path) {
  std::string text;
  for (text_line const& line : read_lines(path)) {
    // "%YAML:1.0" is not a valid YAML directive; files without the % are about, too.
    bool const directive = line.text.compare(0, 5, "%YAML") == 0 ||
                           (line.number == 1 && line.text.compare(0, 5, "YAML:") == 0);
    text += directive ? "#" : with_blank_before_comment(with_blank_after_key(line.text));
    text += '\n';
  }
  return text;
}

/// The text of a node, to compare two.
std::string dump(YAML::Node const& node) {
  return node.IsScalar() ? node.Scalar() : YAML::Dump(node);
}

}  // namespace

yaml_file::yaml_file(std::string const& path) : path_(path) {
  try {
    std::string const text = plain_yaml(path);
    std::size_t const first = text.find_first_not_of(" \t\n");
    bool const xml = first != std::string::npos && text[first] == '<';
    root_ = xml ? read_opencv_xml(text, path) : YAML::Load(text);
    check_map();
  } catch (YAML::Exception const& e) { fail_at(path, e.mark.line + 1, "not valid YAML: " + e.msg); }
}

void yaml_file::check_map() const {
  if (!root_.IsMap()) { throw error(path_ + ": no 'key: value' pairs at the top level"); }
  std::map<std::string, YAML::Node> seen;
  for (auto const& entry : root_) {
    if (!entry.first.IsScalar()) { continue; }
    auto const [place, added] = seen.emplace(entry.first.Scalar(), entry.second);
    if (!added && dump(place->second) != dump(entry.second)) {
      throw error(path_ + ": " + entry.first.Scalar() + " is given twice: " + dump(place->second) +
                  " and " + dump(entry.second));
    }
  }
}

yaml_file yaml_file::part(std::string const& key) const {
  yaml_file inner(path_ + ": " + key, required(key));
  inner.check_map();
  return inner;
}

yaml_file yaml_file::part(std::string const& key, std::size_t index) const {
  YAML::Node const list = required(key);
  std::string const name = key + "[" + std::to_string(index) + "]";
  if (!list.IsSequence() || index >= list.size()) {
    throw missing_key(path_ + ": " + name + " is missing");
  }
  yaml_file inner(path_ + ": " + name, list[index]);
  inner.check_map();
  return inner;
}

std::vector<std::string> yaml_file::unread() const {
  std::vector<std::string> keys;
  for (auto const& entry : root_) {
    if (entry.first.IsScalar() && asked_.count(entry.first.Scalar()) == 0) {
      keys.push_back(entry.first.Scalar());
    }
  }
  return keys;
}

bool yaml_file::has(std::string const& key) const {
  YAML::Node const node = find(key);
  return node.IsDefined() && !node.IsNull();
}

double yaml_file::number(std::string const& key, limits const& range) const {
  return to_checked(required(key), key, range);
}

int yaml_file::integer(std::string const& key, limits const& range) const {
  double const value = number(key, range);
  if (value != std::floor(value)) {
    throw error(path_ + ": " + key + " = " + to_text(value) + ": must be a whole number");
  }
  return static_cast<int>(value);
}

std::string yaml_file::text(std::string const& key) const {
  YAML::Node const node = required(key);
  if (!node.IsScalar()) { throw error(path_ + ": " + key + ": must be a single value"); }
  return node.Scalar();
}

std::vector<double> yaml_file::list(std::string const& key, limits const& range) const {
  return to_list(required(key), key, range);
}

std::vector<double> yaml_file::matrix(std::string const& key, int& rows, int& cols) const {
  YAML::Node const node = required(key);
  rows = cols = 0;
  if (node.IsSequence() && node.size() > 0 && node[0].IsSequence()) {
    std::vector<double> all;
    for (YAML::Node const& item : node) {
      std::vector<double> const row =
          to_list(item, key + "[" + std::to_string(rows) + "]", {-1e9, 1e9});
      cols = rows == 0 ? static_cast<int>(row.size()) : cols;
      if (row.size() != static_cast<std::size_t>(cols)) {
        throw error(path_ + ": " + key + ": its rows have " + std::to_string(cols) + " and " +
                    std::to_string(row.size()) + " numbers, must have as many");
      }
      all.insert(all.end(), row.begin(), row.end());
      ++rows;
    }
    return all;
  }
  if (node.IsSequence()) {
    std::vector<double> const row = to_list(node, key, {-1e9, 1e9});
    rows = 1;
    cols = static_cast<int>(row.size());
    return row;
  }
  if (!node.IsMap()) { throw error(path_ + ": " + key + ": must hold rows, cols and data"); }
  rows = dimension(node, key, "rows");
  cols = dimension(node, key, "cols");
  YAML::Node const data = node["data"];
  if (!data.IsDefined()) { throw error(path_ + ": " + key + ".data is missing"); }
  std::vector<double> values = to_list(data, key + ".data", {-1e9, 1e9});
  if (values.size() != static_cast<std::size_t>(rows) * static_cast<std::size_t>(cols)) {
    throw error(path_ + ": " + key + ".data has " + std::to_string(values.size()) +
                " numbers, must have " + std::to_string(rows) + " x " + std::to_string(cols));
  }
  return values;
}

std::vector<double> yaml_file::matrix_of(std::string const& key, int rows, int cols) const {
  int actual_rows = 0;
  int actual_cols = 0;
  std::vector<double> values = matrix(key, actual_rows, actual_cols);
  if (actual_rows != rows || actual_cols != cols) {
    throw error(path_ + ": " + key + " is " + std::to_string(actual_rows) + " x " +
                std::to_string(actual_cols) + ", must be " + std::to_string(rows) + " x " +
                std::to_string(cols));
  }
  return values;
}

Eigen::Isometry3d yaml_file::transform(std::string const& key) const {
  int rows = 0;
  int cols = 0;
  std::vector<double> const values = matrix(key, rows, cols);
  if ((rows != 3 && rows != 4) || cols != 4) {
    throw error(path_ + ": " + key + " is " + std::to_string(rows) + " x " + std::to_string(cols) +
                ", must be 4 x 4 or 3 x 4");
  }
  return checked_transform(values, path_, key);
}

YAML::Node yaml_file::find(std::string const& key) const {
  asked_.insert(key);
  YAML::Node const& root = root_;  // const access does not insert
  return root[key];
}

YAML::Node yaml_file::required(std::string const& key) const {
  if (!has(key)) { throw missing_key(path_ + ": " + key + " is missing"); }
  return find(key);
}

double yaml_file::to_checked(YAML::Node const& node, std::string const& key,
                             limits const& range) const {
  if (!node.IsScalar()) { throw error(path_ + ": " + key + ": must be a single number"); }
  double value = 0;
  if (!to_number(node.Scalar(), value)) {
    throw error(path_ + ": " + key + " = " + node.Scalar() + ": not a number");
  }
  check_number(value, range, path_, key, node.Scalar());
  return value;
}

std::vector<double> yaml_file::to_list(YAML::Node const& node, std::string const& key,
                                       limits const& range) const {
  if (!node.IsSequence()) { throw error(path_ + ": " + key + ": must be a list of numbers"); }
  std::vector<double> values;
  for (YAML::Node const& item : node) {
    values.push_back(to_checked(item, key + "[" + std::to_string(values.size()) + "]", range));
  }
  return values;
}

int yaml_file::dimension(YAML::Node const& node, std::string const& key,
                         std::string const& name) const {
  YAML::Node const item = node[name];
  if (!item.IsDefined()) { throw error(path_ + ": " + key + "." + name + " is missing"); }
  return static_cast<int>(to_checked(item, key + "." + name, {1, 64}));
}

}  // namespace seq::detail

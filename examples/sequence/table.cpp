// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/detail/table.hpp"

#include <algorithm>

#include "examples/sequence/detail/text.hpp"

namespace seq::detail {
namespace {

std::vector<std::string> fields_of(std::string const& text, char const* separators) {
  bool const blanks = *separators == ' ';
  std::vector<std::string> fields = split(blanks ? trim(text) : text, separators, blanks);
  if (fields.size() > 1 && trim(fields.back()).empty()) { fields.pop_back(); }
  for (std::string& field : fields) {
    field = trim(field);
    if (field.size() > 1 && field.front() == '"' && field.back() == '"') {
      field = trim(field.substr(1, field.size() - 2));
    }
  }
  return fields;
}

/// Without units in brackets, which may have blanks and commas.
std::string without_units(std::string const& heading) {
  std::string names;
  int depth = 0;
  for (char const c : heading) {
    depth += static_cast<int>(c == '[' || c == '(');
    if (depth == 0) { names += c; }
    depth -= static_cast<int>((c == ']' || c == ')') && depth > 0);
  }
  return names.erase(0, std::min(names.size(), names.find_first_not_of(" \t#%")));
}

char const* separators_of(std::string const& text) {
  for (char const* one : {";", ",", "\t"}) {
    if (text.find(*one) != std::string::npos) { return one; }
  }
  return " ";
}

}  // namespace

table read_table(std::string const& path, std::size_t least, std::string const& columns,
                 std::vector<std::string>& warnings) {
  table read;
  char const* separators = nullptr;
  std::vector<std::string> headings;
  int no_numbers = 0;
  std::vector<text_line> const lines = read_lines(path);
  for (text_line const& line : lines) {
    bool const comment = is_blank_or_comment(line.text);
    if (separators == nullptr && (comment || !begins_with_number(line.text))) {
      if (!comment && ++no_numbers > 1) {
        warnings.push_back(path + ":" + std::to_string(line.number) +
                           ": begins with no number, and is left out");
      }
      headings.push_back(without_units(line.text));
      continue;
    }
    if (comment) { continue; }
    if (separators == nullptr) { separators = separators_of(line.text); }
    read.rows.push_back({line.number, fields_of(line.text, separators)});
  }
  if (separators == nullptr) { return read; }
  std::size_t const wide = read.rows.front().fields.size();
  bool const ends = lines.back().ends || lines.back().number != read.rows.back().line;
  std::size_t const whole = ends ? least : wide;
  if (read.rows.size() > 1 && wide >= least && read.rows.back().fields.size() < whole) {
    warnings.push_back(path + ": the last line is cut, and left out");
    read.rows.pop_back();
  }
  for (std::string const& heading : headings) {
    std::vector<std::string> names = fields_of(heading, separators_of(heading));
    if (names.size() == wide && read.names.empty()) { read.names = std::move(names); }
  }
  for (table_row const& row : read.rows) {
    if (row.fields.size() >= least) { continue; }
    fail_at(path, row.line,
            std::to_string(row.fields.size()) + " fields, must have " + std::to_string(least) +
                " (" + columns + ")");
  }
  return read;
}

}  // namespace seq::detail

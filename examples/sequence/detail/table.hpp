// SPDX-License-Identifier: Apache-2.0
/// @file Tables with a record a line, such as EuRoC's data.csv. Not API.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace seq::detail {

struct table_row {
  int line = 0;  ///< of the file, from 1
  std::vector<std::string> fields;
};

struct table {
  std::vector<std::string> names;  ///< of the columns; empty where no heading has them
  std::vector<table_row> rows;
};

/// Fields are apart by semicolons, commas, tabs or blanks: the first of these in the first record.
/// Blanks and double quotes around them are removed, and an empty last field. Lines before the
/// first record that begin with # or with no number are headings; names are those of the first one
/// with as many fields as that record. `warnings` names headings without # but the first. A last
/// line that is cut before its last field is left out, and `warnings` has it.
/// @param least fields of a record @param columns what they are, for the message
/// @throws seq::error when the file cannot be read, or naming the line with fewer fields
table read_table(std::string const& path, std::size_t least, std::string const& columns,
                 std::vector<std::string>& warnings);

}  // namespace seq::detail

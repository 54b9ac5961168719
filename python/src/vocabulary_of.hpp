// SPDX-License-Identifier: Apache-2.0
/// @file Reads a vocabulary of either form.
#pragma once

#include <fstream>
#include <string>

#include "ft/containers/vocabulary_files.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "python/src/conversions.hpp"

namespace ftpy {

/// DBoW2's text form begins with a number, ft's binary one does not.
/// @throws argument_error if the file cannot be opened; ft::error that names a damaged file
inline ft::vocabulary<ft::memory_space::host> vocabulary_of(std::string const& file) {
  std::ifstream from(file, std::ios::binary);
  if (!from) { throw argument_error("vocabulary '" + file + "': cannot be opened"); }
  int const first = from.peek();
  try {
    bool const text = first >= '0' && first <= '9';
    return text ? ft::read_vocabulary_text(from) : ft::load_vocabulary(from);
  } catch (ft::error const& e) { throw ft::error("vocabulary '" + file + "': " + e.what()); }
}

}  // namespace ftpy

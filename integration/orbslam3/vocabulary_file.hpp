// SPDX-License-Identifier: Apache-2.0
/// @file The vocabulary that ORB-SLAM3 is started with, from its file.
#pragma once

#include <chrono>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <string>
#include <system_error>

#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_files.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "ft/core/error.hpp"
#include "ft/core/memory.hpp"

namespace ft {
namespace orbslam3 {
inline namespace FT_ABI {

namespace vocabulary_detail {

/// Whether `file` exists and is not older than what it was made of.
inline bool is_current(std::string const& file, std::string const& made_of) {
  std::error_code first;
  std::error_code second;
  auto const made = std::filesystem::last_write_time(file, first);
  auto const changed = std::filesystem::last_write_time(made_of, second);
  return !first && !second && made >= changed;
}
/// Where it cannot be written, the next start reads the text again. Several processes may write.
inline void write_beside(std::string const& file, vocabulary_view const& v) {
  auto const now = std::chrono::steady_clock::now().time_since_epoch().count();
  std::string const part = file + "." + std::to_string(now);
  std::error_code failed;
  try {
    std::ofstream to(part, std::ios::binary);
    if (!to) { return; }
    save_vocabulary(to, v);
    to.close();
    if (to) { std::filesystem::rename(part, file, failed); }
  } catch (error const&) {  // no room
  }
  std::filesystem::remove(part, failed);
}

}  // namespace vocabulary_detail

/// Reads DBoW2's text form, or ft's binary form. Of a text the binary form is written beside it,
/// as "<path>.ft", and read instead of the text as long as it is not older.
/// @throws error for a file that cannot be opened or is no vocabulary; bad_argument, std::bad_alloc
inline vocabulary<memory_space::host> read_vocabulary(std::string const& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) { throw error("ft: the vocabulary '" + path + "' cannot be opened"); }
  char first[sizeof "ft vocabulary"] = {};
  file.read(first, sizeof first);
  file.clear();
  file.seekg(0);
  if (std::memcmp(first, "ft vocabulary", sizeof first) == 0) { return load_vocabulary(file); }
  std::string const beside = path + ".ft";
  if (vocabulary_detail::is_current(beside, path)) {
    try {
      std::ifstream binary(beside, std::ios::binary);
      return load_vocabulary(binary);
    } catch (error const&) {  // damaged, or of another version: made again
    }
  }
  auto made = read_vocabulary_text(file);
  vocabulary_detail::write_beside(beside, made.view());
  return made;
}

}  // namespace FT_ABI
}  // namespace orbslam3
}  // namespace ft

// SPDX-License-Identifier: Apache-2.0
/// @file Temporary folders, text files, test calibrations and the folder of real data, for the
/// tests.
#pragma once

#include <gtest/gtest.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "examples/sequence/image_io.hpp"
#include "examples/sequence/reader.hpp"
#include "examples/sequence/types.hpp"

namespace seq_test {

/// A folder that exists as long as this object; unique to the process and the object.
class temp_folder {
public:
  temp_folder() {
    std::string pattern =
        (std::filesystem::temp_directory_path() / "ft_sequence_test_XXXXXX").string();
    if (::mkdtemp(pattern.data()) == nullptr) {
      throw std::runtime_error("no temporary folder " + pattern);
    }
    path_ = pattern;
  }
  temp_folder(temp_folder const&) = delete;
  temp_folder& operator=(temp_folder const&) = delete;
  ~temp_folder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }

  std::string path() const { return path_.string(); }
  std::string path(std::string const& name) const { return (path_ / name).string(); }
  /// Writes a file, and creates its folders. @return its path
  std::string write(std::string const& name, std::string const& text) const {
    std::filesystem::create_directories((path_ / name).parent_path());
    std::ofstream(path_ / name, std::ios::binary) << text;
    return path(name);
  }

private:
  std::filesystem::path path_;
};

/// The folder with `data` and `golden`: FT_DATA, or `shared` next to the project; empty without
/// either.
inline std::string shared_folder() {
  namespace fs = std::filesystem;
  if (char const* given = std::getenv("FT_DATA")) { return given; }
  fs::path const project = fs::absolute(__FILE__).parent_path().parent_path().parent_path();
  for (fs::path const& candidate : {project.parent_path() / "shared", fs::path("../shared")}) {
    std::error_code ignored;
    if (fs::is_directory(candidate / "data", ignored)) { return candidate.string(); }
  }
  return {};
}

/// `text` with the one occurrence of `from` replaced.
inline std::string replaced(std::string text, std::string const& from, std::string const& to) {
  std::size_t const at = text.find(from);
  if (at == std::string::npos) { throw std::runtime_error("test text holds no '" + from + "'"); }
  return text.replace(at, from.size(), to);
}

/// The message of the seq::error that `function` throws. Without one: empty, and a test failure.
template <typename F>
std::string message_of(F const& function) {
  try {
    function();
  } catch (seq::error const& e) { return e.what(); }
  ADD_FAILURE() << "no seq::error thrown";
  return {};
}

inline bool contains(std::string const& text, std::string const& part) {
  return text.find(part) != std::string::npos;
}

/// A change of a text, and what is said of it then.
struct bad_text {
  std::string from, to, says;
};
/// A file with each change is refused, and named. @param read (path of the file)
template <typename Read>
void expect_refused(std::string const& file, std::string const& good,
                    std::vector<bad_text> const& changes, Read const& read) {
  temp_folder const folder;
  for (bad_text const& c : changes) {
    std::string const path = folder.write(file, replaced(good, c.from, c.to));
    std::string const message = message_of([&] { read(path); });
    EXPECT_TRUE(contains(message, c.says)) << c.says << "\n" << message;
    EXPECT_TRUE(contains(message, path)) << message;
  }
}

/// Writes a PNG of 64 x 48 pixels whose first is `value`, the others 40.
inline void put(temp_folder const& folder, std::string const& name, int value) {
  std::filesystem::create_directories(std::filesystem::path(folder.path(name)).parent_path());
  seq::image picture{64, 48, std::vector<std::uint8_t>(64 * 48, 40)};
  picture.pixels[0] = static_cast<std::uint8_t>(value);
  seq::write_png(folder.path(name), picture);
}

inline std::vector<std::int64_t> times_of(seq::sequence const& s) {
  std::vector<std::int64_t> times;
  for (int i = 0; i < s.size(); ++i) { times.push_back(s.time_ns(i)); }
  return times;
}

}  // namespace seq_test

/// Skips if the real data are not on this machine.
#define SEQ_TEST_SHARED_OR_SKIP(name)                                      \
  std::string const name = seq_test::shared_folder();                      \
  if (name.empty())                                                        \
  GTEST_SKIP() << "no reference data: set FT_DATA to the folder of data/ " \
                  "and golden/"

// SPDX-License-Identifier: Apache-2.0
/// @file Reads PLY files.
#pragma once

#include <gtest/gtest.h>

#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <sstream>
#include <string>
#include <vector>

namespace test {

struct ply_vertex {
  std::vector<float> real;
  std::vector<int> byte;
};

/// A reader of PLY with one element, whose floats come before its bytes.
struct ply_file {
  std::string format;
  std::vector<std::string> names;
  std::vector<ply_vertex> vertices;
  bool at_end = false;

  explicit ply_file(std::string const& bytes) {
    std::istringstream in(bytes);
    std::string line, word, type;
    std::getline(in, line);
    EXPECT_EQ(line, "ply");
    std::size_t count = 0, reals = 0;
    while (std::getline(in, line) && line != "end_header") {
      std::istringstream words(line);
      words >> word;
      if (word == "format") { words >> format; }
      if (word == "element") { words >> word >> count; }
      if (word != "property") { continue; }
      words >> type >> word;
      names.push_back(word);
      reals += type == "float" ? 1 : 0;
    }
    for (std::size_t v = 0; v < count; ++v) {
      vertices.emplace_back();
      for (std::size_t i = 0; i < names.size(); ++i) {
        bool const real = i < reals;
        if (format == "ascii") {
          in >> word;
          if (real) {
            vertices.back().real.push_back(std::strtof(word.c_str(), nullptr));
          } else {
            vertices.back().byte.push_back(std::stoi(word));
          }
          continue;
        }
        unsigned char raw[4] = {};
        in.read(reinterpret_cast<char*>(raw), real ? 4 : 1);
        auto const bits = static_cast<std::uint32_t>(raw[0] | raw[1] << 8 | raw[2] << 16) |
                          static_cast<std::uint32_t>(raw[3]) << 24;
        float value = 0;
        std::memcpy(&value, &bits, sizeof value);
        if (real) {
          vertices.back().real.push_back(value);
        } else {
          vertices.back().byte.push_back(raw[0]);
        }
      }
    }
    EXPECT_TRUE(static_cast<bool>(in));
    in >> std::ws;
    at_end = in.peek() == std::istringstream::traits_type::eof();
  }
};

}  // namespace test

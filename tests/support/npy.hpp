// SPDX-License-Identifier: Apache-2.0
/// @file A reader of .npy 1.0 arrays (little endian, C order), the format of the golden files.
#pragma once

#include <cstdint>
#include <cstring>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace test {

/// @tparam T element type; must be the file's
template <typename T>
struct npy {
  std::vector<int> shape;
  std::vector<T> data;

  int rows() const { return shape.empty() ? 1 : shape[0]; }
  int cols() const {
    int n = 1;
    for (std::size_t i = 1; i < shape.size(); ++i) { n *= shape[i]; }
    return n;
  }
  T const& operator()(int r, int c = 0) const {
    return data.at(static_cast<std::size_t>(r * cols() + c));
  }
};

template <typename T>
constexpr char const* npy_type();
template <>
constexpr char const* npy_type<std::uint8_t>() {
  return "|u1";
}
template <>
constexpr char const* npy_type<std::int32_t>() {
  return "<i4";
}
template <>
constexpr char const* npy_type<std::uint32_t>() {
  return "<u4";
}
template <>
constexpr char const* npy_type<std::uint64_t>() {
  return "<u8";
}
template <>
constexpr char const* npy_type<float>() {
  return "<f4";
}
template <>
constexpr char const* npy_type<double>() {
  return "<f8";
}

inline bool exists(std::string const& path) { return std::ifstream(path).good(); }

/// @throws std::runtime_error naming the file
template <typename T>
npy<T> read_npy(std::string const& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file.is_open()) { throw std::runtime_error(path + ": missing"); }
  char magic[10] = {};
  if (!file.read(magic, 10) || std::memcmp(magic, "\x93NUMPY\x01", 7) != 0) {
    throw std::runtime_error(path + ": not an npy 1.0 file");
  }
  auto const length = static_cast<std::size_t>(static_cast<unsigned char>(magic[8])) +
                      256u * static_cast<unsigned char>(magic[9]);
  std::string header(length, ' ');
  file.read(header.data(), static_cast<std::streamsize>(length));
  if (header.find(std::string("'") + npy_type<T>() + "'") == std::string::npos ||
      header.find("'fortran_order': False") == std::string::npos) {
    throw std::runtime_error(path + ": unexpected type: " + header);
  }
  npy<T> array;
  std::size_t n = 1;
  std::size_t i = header.find('(') + 1;
  while (header[i] != ')') {
    if (header[i] >= '0' && header[i] <= '9') {
      std::size_t used = 0;
      array.shape.push_back(std::stoi(header.substr(i), &used));
      n *= static_cast<std::size_t>(array.shape.back());
      i += used;
    } else {
      ++i;
    }
  }
  array.data.resize(n);
  if (!file.read(reinterpret_cast<char*>(array.data.data()),
                 static_cast<std::streamsize>(n * sizeof(T)))) {
    throw std::runtime_error(path + ": truncated");
  }
  return array;
}

}  // namespace test

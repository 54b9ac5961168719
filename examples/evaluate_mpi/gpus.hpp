// SPDX-License-Identifier: Apache-2.0
/// @file The GPUs of this host, without CUDA: a rank chooses one before its jobs start.
#pragma once

#include <algorithm>
#include <cctype>
#include <cstdlib>
#include <filesystem>
#include <sstream>
#include <string>
#include <system_error>
#include <vector>

namespace app {

/// Number of device files of NVIDIA's driver: /dev/nvidia0, /dev/nvidia1, ...
inline int count_gpus() {
  int count = 0;
  std::error_code failure;
  for (auto const& entry : std::filesystem::directory_iterator("/dev", failure)) {
    std::string const name = entry.path().filename().string();
    bool const numbered = name.rfind("nvidia", 0) == 0 && name.size() > 6 &&
                          std::all_of(name.begin() + 6, name.end(), [](char c) {
                            return std::isdigit(static_cast<unsigned char>(c)) != 0;
                          });
    count += static_cast<int>(numbered);
  }
  return count;
}

/// Names for CUDA_VISIBLE_DEVICES, one per GPU: the entries of that variable if a scheduler has set
/// it, else 0, 1, ...
/// @param gpus number of GPUs; below 0: counted
inline std::vector<std::string> visible_gpus(int gpus) {
  std::vector<std::string> names;
  if (char const* given = std::getenv("CUDA_VISIBLE_DEVICES"); given != nullptr && gpus < 0) {
    std::istringstream list(given);
    for (std::string name; std::getline(list, name, ',');) { names.push_back(name); }
    return names;
  }
  int const count = gpus < 0 ? count_gpus() : gpus;
  for (int i = 0; i < count; ++i) { names.push_back(std::to_string(i)); }
  return names;
}

}  // namespace app

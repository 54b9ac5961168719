// SPDX-License-Identifier: Apache-2.0
/// @file The jobs that evaluate_mpi hands out.
#pragma once

#include <nlohmann/json.hpp>

#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

namespace app {

struct job {
  std::string name;                  ///< shown in progress messages
  std::vector<std::string> command;  ///< program and arguments
};

/// @throws std::runtime_error naming the file and the error
inline std::vector<job> read_plan(std::string const& path) {
  std::ifstream file(path);
  if (!file) { throw std::runtime_error(path + ": cannot be read"); }
  std::vector<job> jobs;
  try {
    for (auto const& entry : nlohmann::json::parse(file)) {
      jobs.push_back({entry.at("name"), entry.at("command")});
      if (jobs.back().command.empty()) {
        throw std::runtime_error(path + ": job '" + jobs.back().name + "' has no command");
      }
    }
  } catch (nlohmann::json::exception const& e) {
    throw std::runtime_error(path + ": not a plan: " + e.what());
  }
  return jobs;
}

}  // namespace app

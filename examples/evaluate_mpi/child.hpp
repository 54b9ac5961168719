// SPDX-License-Identifier: Apache-2.0
/// @file A child process that is asked, not waited for, whether it has ended.
#pragma once

#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <optional>
#include <string>
#include <vector>

extern char** environ;

namespace app {

constexpr int cannot_start = 127;  ///< as a shell's status

/// Started when made. Its end must be seen by `status` before it is destroyed.
class child {
public:
  explicit child(std::vector<std::string> const& command) {
    std::vector<char*> arguments;
    for (auto const& word : command) { arguments.push_back(const_cast<char*>(word.c_str())); }
    arguments.push_back(nullptr);
    if (posix_spawnp(&pid_, arguments[0], nullptr, nullptr, arguments.data(), environ) != 0) {
      pid_ = 0;
    }
  }

  /// Nothing while it runs; else its exit status, 128 and the signal where one ended it.
  std::optional<int> status() const {
    if (pid_ == 0) { return cannot_start; }
    int status = 0;
    if (waitpid(pid_, &status, WNOHANG) == 0) { return std::nullopt; }
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

private:
  pid_t pid_ = 0;
};

}  // namespace app

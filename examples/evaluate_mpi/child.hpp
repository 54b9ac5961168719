// SPDX-License-Identifier: Apache-2.0
/// @file A child process whose end is polled, without waiting.
#pragma once

#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

namespace app {

constexpr int cannot_start = 127;  ///< as a shell's status

/// Starts the process. It is killed when this process ends, for whatever reason (Linux).
class child {
public:
  /// @throws std::system_error if no process can be started
  explicit child(std::vector<std::string> const& command) {
    std::vector<char*> arguments;
    for (auto const& word : command) { arguments.push_back(const_cast<char*>(word.c_str())); }
    arguments.push_back(nullptr);
    pid_ = fork();
    if (pid_ < 0) { throw std::system_error(errno, std::generic_category(), "fork"); }
    if (pid_ == 0) {
      prctl(PR_SET_PDEATHSIG, SIGTERM);
      execvp(arguments[0], arguments.data());
      _exit(cannot_start);
    }
  }

  /// Nothing while the process runs; else its exit status, or 128 plus the signal that ended it.
  /// Must not be called again after that.
  std::optional<int> status() const {
    int status = 0;
    if (waitpid(pid_, &status, WNOHANG) == 0) { return std::nullopt; }
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

private:
  pid_t pid_ = -1;
};

}  // namespace app

// SPDX-License-Identifier: Apache-2.0
/// @file A child process that is asked, not waited for, whether it has ended.
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

/// Started when made. It is ended with this process, however that ends (Linux).
class child {
public:
  /// @throws std::system_error where there can be no more processes
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

  /// Nothing while it runs; else its exit status, 128 and the signal where one ended it. Not to be
  /// asked again after that.
  std::optional<int> status() const {
    int status = 0;
    if (waitpid(pid_, &status, WNOHANG) == 0) { return std::nullopt; }
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }

private:
  pid_t pid_ = -1;
};

}  // namespace app

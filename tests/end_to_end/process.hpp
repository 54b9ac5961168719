// SPDX-License-Identifier: Apache-2.0
/// @file Runs a program as its users do: arguments in, exit status and both outputs out.
#pragma once

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/types.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <fstream>
#include <functional>
#include <iterator>
#include <ostream>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

#include "tests/support/sequence.hpp"

namespace app_test {

/// How a child process ended, and what it wrote.
struct outcome {
  int status = -1;  ///< exit status; -1 where a signal ended it
  int signal = 0;   ///< the signal that ended it; 0 = it exited by itself
  bool timed_out = false;
  std::string command, out, err;
};

inline std::ostream& operator<<(std::ostream& stream, outcome const& o) {
  stream << o.command << "\n";
  if (o.timed_out) { stream << "killed: out of time\n"; }
  if (o.signal != 0) {
    stream << "ended by signal " << o.signal << " (" << ::strsignal(o.signal) << ")\n";
  } else {
    stream << "exit status " << o.status << "\n";
  }
  return stream << "stderr:\n"
                << o.err << "end of stdout:\n"
                << (o.out.size() > 2000 ? o.out.substr(o.out.size() - 2000) : o.out);
}

inline std::string read_file(std::string const& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) { throw std::runtime_error("cannot read " + path); }
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

/// The environment, with every finding of a sanitizer an abort: their exit status would otherwise
/// be 1, as that of an error the program reports itself.
inline std::vector<std::string> child_environment() {
  std::vector<std::string> all;
  std::string sanitizers[] = {"ASAN_OPTIONS=", "UBSAN_OPTIONS="};
  for (char** entry = environ; *entry != nullptr; ++entry) {
    std::string const text = *entry;
    bool kept = true;
    for (std::string& name : sanitizers) {
      if (text.compare(0, text.find('=') + 1, name.substr(0, name.find('=') + 1)) == 0) {
        name = text + ":";
        kept = false;
      }
    }
    if (kept) { all.push_back(text); }
  }
  for (std::string const& name : sanitizers) { all.push_back(name + "abort_on_error=1"); }
  return all;
}

/// What a test does while the program runs, given its process and what it wrote to stdout so far.
/// Called again and again until it returns true.
using meanwhile = std::function<bool(pid_t, std::string const& out)>;

/// Runs `program` to its end. @throws std::runtime_error where it cannot be started
inline outcome run_program(std::string const& program, std::vector<std::string> arguments,
                           std::chrono::seconds patience = std::chrono::seconds(300),
                           meanwhile doing = {}) {
  outcome result;
  result.command = program;
  for (std::string const& argument : arguments) { result.command += " " + argument; }
  arguments.insert(arguments.begin(), program);
  std::vector<std::string> environment = child_environment();
  auto const pointers = [](std::vector<std::string>& texts) {
    std::vector<char*> all;
    for (std::string& text : texts) { all.push_back(text.data()); }
    all.push_back(nullptr);
    return all;
  };

  seq_test::temp_folder const logs;
  std::string const out = logs.path("out");
  std::string const err = logs.path("err");
  posix_spawn_file_actions_t files;
  posix_spawn_file_actions_init(&files);
  constexpr int how = O_WRONLY | O_CREAT | O_TRUNC;
  posix_spawn_file_actions_addopen(&files, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
  posix_spawn_file_actions_addopen(&files, STDOUT_FILENO, out.c_str(), how, 0600);
  posix_spawn_file_actions_addopen(&files, STDERR_FILENO, err.c_str(), how, 0600);
  pid_t child = 0;
  int const failure = ::posix_spawn(&child, program.c_str(), &files, nullptr,
                                    pointers(arguments).data(), pointers(environment).data());
  posix_spawn_file_actions_destroy(&files);
  if (failure != 0) {
    throw std::runtime_error("cannot run " + program + ": " + std::strerror(failure));
  }

  auto const deadline = std::chrono::steady_clock::now() + patience;
  int state = 0;
  for (;;) {
    pid_t const ended = ::waitpid(child, &state, result.timed_out ? 0 : WNOHANG);
    if (ended == child) { break; }
    if (ended < 0 && errno != EINTR) {
      throw std::runtime_error(std::string("waitpid: ") + std::strerror(errno));
    }
    if (std::chrono::steady_clock::now() > deadline) {
      result.timed_out = true;
      ::kill(child, SIGKILL);
    } else {
      if (doing && doing(child, read_file(out))) { doing = {}; }
      std::this_thread::sleep_for(std::chrono::milliseconds(2));
    }
  }
  if (WIFSIGNALED(state)) {
    result.signal = WTERMSIG(state);
  } else {
    result.status = WEXITSTATUS(state);
  }
  result.out = read_file(out);
  result.err = read_file(err);
  return result;
}

}  // namespace app_test

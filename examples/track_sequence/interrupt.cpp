// SPDX-License-Identifier: Apache-2.0
#include "examples/track_sequence/interrupt.hpp"

#include <signal.h>

#include <csignal>
#include <initializer_list>

namespace app {
namespace {

volatile std::sig_atomic_t received = 0;

extern "C" void on_interrupt(int signal) { received = signal; }

}  // namespace

void watch_interrupts() {
  for (int const signal : {SIGINT, SIGTERM}) {
    struct sigaction before {};
    if (::sigaction(signal, nullptr, &before) == 0 && before.sa_handler == SIG_IGN) { continue; }
    struct sigaction action {};
    action.sa_handler = on_interrupt;
    action.sa_flags = static_cast<int>(SA_RESETHAND) | SA_RESTART;
    ::sigemptyset(&action.sa_mask);
    ::sigaction(signal, &action, nullptr);
  }
}

char const* interrupted() {
  switch (received) {
    case 0:
      return nullptr;
    case SIGINT:
      return "SIGINT";
    default:
      return "SIGTERM";
  }
}

}  // namespace app

// SPDX-License-Identifier: Apache-2.0
#include "examples/sequence/read_ahead.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <mutex>
#include <set>
#include <stdexcept>
#include <string>
#include <thread>
#include <vector>

namespace read_ahead_test {

/// A frame that says which one it is.
seq::stereo_frame frame_of(int i) {
  seq::stereo_frame frame;
  frame.time_ns = 1000 + i;
  frame.left.width = frame.left.height = 4;
  frame.left.pixels.assign(16, static_cast<std::uint8_t>(i));
  frame.right = frame.left;
  return frame;
}

void expect_frame(seq::stereo_frame const& frame, int i) {
  EXPECT_EQ(frame.time_ns, 1000 + i);
  EXPECT_EQ(frame.left.pixels, std::vector<std::uint8_t>(16, static_cast<std::uint8_t>(i)));
}

/// Takes longer for some frames than for those after them.
void dawdle(int i) {
  std::this_thread::sleep_for(std::chrono::microseconds(i % 5 == 0 ? 900 : 50));
}

TEST(ReadAhead, FramesComeInOrder) {
  for (int const ahead : {0, 1, 3, 16, 500}) {
    for (int const threads : {1, 2, 7}) {
      seq::read_ahead reader(
          [](int i) {
            dawdle(i);
            return frame_of(i);
          },
          60, ahead, threads);
      for (int i = 0; i < 60; ++i) { expect_frame(reader.take(i), i); }
    }
  }
}

TEST(ReadAhead, EachFrameIsLoadedOnce) {
  std::mutex guard;
  std::multiset<int> loaded;
  {
    seq::read_ahead reader(
        [&](int i) {
          std::lock_guard<std::mutex> const lock(guard);
          loaded.insert(i);
          return frame_of(i);
        },
        40, 8, 4);
    for (int i = 0; i < 40; ++i) { reader.take(i); }
  }
  ASSERT_EQ(loaded.size(), 40u);
  EXPECT_EQ(std::set<int>(loaded.begin(), loaded.end()).size(), 40u);
}

TEST(ReadAhead, ErrorsArriveAtTheirFrame) {
  for (int const ahead : {0, 6}) {
    seq::read_ahead reader(
        [](int i) {
          if (i == 5 || i == 6) { throw std::runtime_error("frame " + std::to_string(i)); }
          return frame_of(i);
        },
        12, ahead, 3);
    for (int i = 0; i < 12; ++i) {
      if (i != 5 && i != 6) {
        expect_frame(reader.take(i), i);
        continue;
      }
      try {
        reader.take(i);
        ADD_FAILURE() << "frame " << i << " was taken";
      } catch (std::runtime_error const& e) { EXPECT_EQ(e.what(), "frame " + std::to_string(i)); }
    }
  }
}

TEST(ReadAhead, FramesLeftOutBringNoErrors) {
  for (int const ahead : {0, 1, 4, 64}) {
    seq::read_ahead reader(
        [](int i) {
          dawdle(i);
          if (i % 7 != 0) { throw std::runtime_error("left out"); }
          return frame_of(i);
        },
        70, ahead, 4);
    for (int i = 0; i < 70; i += 7) { expect_frame(reader.take(i), i); }
  }
}

TEST(ReadAhead, LoadsNoFurtherThanTheQueueIsLong) {
  constexpr int ahead = 5;
  std::atomic<int> highest{-1};
  seq::read_ahead reader(
      [&](int i) {
        int before = highest;
        while (before < i && !highest.compare_exchange_weak(before, i)) {}
        return frame_of(i);
      },
      100, ahead, 4);
  for (int i = 0; i < 20; ++i) {
    reader.take(i);
    auto const patience = std::chrono::steady_clock::now() + std::chrono::seconds(20);
    while (highest < i + ahead && std::chrono::steady_clock::now() < patience) {
      std::this_thread::yield();
    }
    EXPECT_EQ(highest, i + ahead);  // as far as it may
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    EXPECT_EQ(highest, i + ahead);  // and no further
  }
}

// Four frames are loaded at once: each waits until the other three have begun.
TEST(ReadAhead, ThreadsLoadAtTheSameTime) {
  std::atomic<int> begun{0};
  seq::read_ahead reader(
      [&](int i) {
        ++begun;
        auto const patience = std::chrono::steady_clock::now() + std::chrono::seconds(20);
        while (begun < 4 && std::chrono::steady_clock::now() < patience) {
          std::this_thread::yield();
        }
        EXPECT_GE(begun, 4) << "frame " << i;
        return frame_of(i);
      },
      4, 4, 4);
  for (int i = 0; i < 4; ++i) { expect_frame(reader.take(i), i); }
}

TEST(ReadAhead, EndsBeforeTheLastFrame) {
  std::atomic<int> loaded{0};
  {
    seq::read_ahead reader(
        [&](int i) {
          ++loaded;
          return frame_of(i);
        },
        1000, 4, 2);
    expect_frame(reader.take(0), 0);
  }
  EXPECT_LE(loaded, 6);
  seq::read_ahead const unused([](int i) { return frame_of(i); }, 0, 4, 2);
}

TEST(ReadAhead, RefusesFramesThatAreGone) {
  seq::read_ahead reader([](int i) { return frame_of(i); }, 10, 3, 2);
  reader.take(4);
  EXPECT_THROW(reader.take(4), seq::error);
  EXPECT_THROW(reader.take(2), seq::error);
  EXPECT_THROW(reader.take(10), seq::error);
  EXPECT_THROW(reader.take(-1), seq::error);
  expect_frame(reader.take(9), 9);
  EXPECT_THROW(seq::read_ahead([](int i) { return frame_of(i); }, 10, -1), seq::error);
  EXPECT_THROW(seq::read_ahead([](int i) { return frame_of(i); }, -1, 1), seq::error);
  EXPECT_THROW(seq::read_ahead([](int i) { return frame_of(i); }, 10, 1, -1), seq::error);
}

}  // namespace read_ahead_test

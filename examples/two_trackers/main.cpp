// SPDX-License-Identifier: Apache-2.0
// Two trackers in two threads, each with an executor of its own (on a GPU: a stream). They share
// nothing, so their results are bit-identical to those of the same trackers run one after the
// other.
#include <cstdio>
#include <cstring>
#include <exception>
#include <thread>
#include <vector>

#include "examples/common/run.hpp"
#include "examples/common/scene.hpp"
#include "examples/common/simple_odometry.hpp"

constexpr int frames = 12;

/// The input of one tracker.
struct sequence {
  demo::scene scene;
  std::vector<demo::image_pair> images;

  explicit sequence(int width) : scene(frames, width) {
    for (int i = 0; i < frames; ++i) { images.push_back(scene.render(i)); }
  }
};

template <typename Exec>
void track(Exec const& exec, sequence const& seen, std::vector<ft::pose>& poses) {
  demo::simple_odometry<Exec> odometry(exec, seen.scene);
  for (auto const& images : seen.images) {
    odometry.track(images);
    poses.push_back(odometry.T_cw());
  }
}

/// The work of a thread; its exception is kept for the thread that joins it.
struct worker {
  std::vector<ft::pose> poses;
  std::exception_ptr error;

  void operator()(sequence const& seen) {
    try {
#if defined(__CUDACC__)
      ft::stream const mine;
      track(ft::cuda_exec(mine.get()), seen, poses);
#else
      track(ft::host_exec(1), seen, poses);  // one thread each, without a shared pool
#endif
    } catch (...) { error = std::current_exception(); }
  }
};

bool same(std::vector<ft::pose> const& a, std::vector<ft::pose> const& b) {
  return a.size() == frames && b.size() == frames &&
         std::memcmp(a.data(), b.data(), frames * sizeof(ft::pose)) == 0;
}

int main() {
  return demo::guarded([] {
#if defined(__CUDACC__)
    if (!demo::has_device()) { return demo::no_device(); }
#endif
    sequence const seen[2] = {sequence(752), sequence(640)};
    worker alone[2];
    worker together[2];
    for (int i = 0; i < 2; ++i) { alone[i](seen[i]); }
    std::thread first([&] { together[0](seen[0]); });
    std::thread second([&] { together[1](seen[1]); });
    first.join();
    second.join();
    for (worker const* w : {&alone[0], &alone[1], &together[0], &together[1]}) {
      if (w->error) { std::rethrow_exception(w->error); }
    }
    bool const good =
        same(alone[0].poses, together[0].poses) && same(alone[1].poses, together[1].poses);
    std::printf("two trackers, %d frames each: %s\n", frames,
                good ? "the same poses alone and side by side" : "the poses differ");
    return demo::verdict(good);
  });
}

// SPDX-License-Identifier: Apache-2.0
/// @file The order of launches of a frame, and which of them run concurrently. No other file
/// decides that.
///
/// Every line enqueues one stage. `line.then(name)` is the executor for a launch that runs when the
/// preceding grid has completed. `line.with(name)` is the executor for a launch that starts when
/// the preceding grid has started; the two share data only through signals. The launch after such a
/// pair waits for both. `line.both(a, b)` enqueues two chains that share no data, and
/// `line.beside(branch, name, side, main)` a chain on a branch beside one on the main line. Names
/// are those of stage_times(). On the host stages run in the order of the lines, and such chains at
/// the same time unless stages are timed.
///
/// Why stages overlap: the pyramid is computed from the rows that have arrived while the bus is the
/// bottleneck; distribution and ordering have one block per image and level, which leaves most of a
/// device idle; listing candidates needs no stereo matches, choosing from them does. Of a batch,
/// the bus has images of one part while the device finds the keypoints of those before.
#pragma once

#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/core/recording.hpp"
#include "ft/core/stage_clock.hpp"
#include "ft/types/poses.hpp"

namespace ft {
inline namespace FT_ABI {
namespace detail {

/// Selects the executors of stages and marks the ends of stages.
template <typename Exec>
class stage_line {
public:
  stage_line(Exec const& exec, stage_clock<Exec>& clock) : exec_(exec), clock_(clock) {
    clock_.begin(exec_);
  }
  Exec then(char const* stage) {
    end_stage(stage);
    return with_order(exec_, launch_order::serial);
  }
  Exec with(char const* stage) {
    end_stage(stage);
    return with_order(exec_, launch_order::concurrent);
  }
  /// Enqueues a(line), and b(line) after it.
  template <typename A, typename B>
  void both(A const& a, B const& b) {
    if constexpr (!Exec::asynchronous) {
      if (!clock_.enabled()) {
        stage_line other = *this;
        exec_.both([&] { a(*this); }, [&] { b(other); });
        return;
      }
    }
    a(*this);
    b(*this);
  }
  /// Enqueues side(executor of the branch) and main(line), which run concurrently. Later launches
  /// wait for both. @param stage name of the side
  template <typename Side, typename Main>
  void beside(side_branch<Exec>& branch, char const* stage, Side const& side, Main const& main) {
    if constexpr (!Exec::asynchronous) {
      if (!clock_.enabled()) {
        exec_.both([&] { main(*this); }, [&] { side(exec_); });
        return;
      }
    }
    Exec const of_branch = fork(branch);
    side(of_branch);
    end_of_branch(of_branch, stage);
    main(*this);
    join(branch);
  }
  /// An executor for launches that run concurrently with all later ones, until join().
  Exec fork(side_branch<Exec>& branch) {
    fork_ = end_stage(nullptr);
    return branch.fork(exec_);
  }
  /// The branch's executor for a stage. Ends the preceding stage, which on the host is the one
  /// enqueued before it.
  Exec const& on(Exec const& branch) {
    end_stage(nullptr);
    return branch;
  }
  /// Marks the end of a stage on a branch.
  void end_of_branch(Exec const& branch, char const* stage) { clock_.mark(branch, stage, fork_); }
  void join(side_branch<Exec>& branch) {
    end_stage(nullptr);
    branch.join(exec_);
  }
  void end() { end_stage(nullptr); }
  /// Whether stages are timed.
  bool timed() const { return clock_.enabled(); }
  /// Enqueues chain(line of the branch), which runs concurrently with all later launches, until
  /// join(). Not timed.
  template <typename Chain>
  void aside(side_branch<Exec>& branch, Chain const& chain) {
    stage_line other = *this;
    other.exec_ = fork(branch);
    chain(other);
  }

private:
  /// Marks the end of the preceding stage. @return the mark
  int end_stage(char const* next) {
    if (stage_ != nullptr) { last_ = clock_.mark(exec_, stage_); }
    stage_ = next;
    return last_;
  }

  Exec exec_;
  stage_clock<Exec>& clock_;
  char const* stage_ = nullptr;
  int last_ = 0;
  int fork_ = 0;
};

/// Keypoints of images whose pyramids are enqueued.
/// @param f an extraction, or a type with the same stages
template <typename Line, typename Features>
void queue_features(Line& line, Features const& f) {
  f.detect(line.then("corners"));
  line.both([&](Line& l) { f.distribute(l.then("distribution")); },
            [&](Line& l) { f.blur(l.with("blur")); });
  if (f.drops_edges()) { f.drop_edges(line.then("distribution")); }
  f.order(line.then("order"));
  f.describe(line.with("descriptors"));
  if (f.refines_positions()) { f.refine(line.then("descriptors")); }
}

/// The same as queue_images() part by part.
template <typename Line, typename Stages>
void queue_image_parts(Line& line, Stages& s, bool with_local) {
  for (int k = 0; k < s.parts(); ++k) {
    auto const part = s.part(k);
    s.upload_part(line.then("upload"), part.stages, with_local);
    line.aside(s.branch_of_part(k), [&](Line& l) {
      part.build_levels(l.then("pyramid"));
      queue_features(l, part);
    });
  }
  for (int k = 0; k < s.parts(); ++k) { line.join(s.branch_of_part(k)); }
}

/// Images and inputs of a frame, and its keypoints. @param with_local also uploads the local map
/// @param then called once the images are enqueued
template <typename Line, typename Stages, typename Then>
void queue_images(Line& line, Stages& s, bool with_local, Then const& then) {
  if constexpr (Stages::in_parts) {
    if (s.parts() > 1 && !line.timed()) {
      queue_image_parts(line, s, with_local);
      return then();
    }
  }
  s.upload(line.then("upload"), with_local);
  if (s.pyramid_overlaps_upload()) {
    s.pyramid_of_upload(line.with("pyramid"));
  } else {
    s.build_levels(line.then("pyramid"));
  }
  then();
  queue_features(line, s);
}
template <typename Line, typename Stages>
void queue_images(Line& line, Stages& s, bool with_local) {
  queue_images(line, s, with_local, [] {});
}

/// A frame without a search.
template <typename Line, typename Stages>
void queue_extract(Line& line, Stages& s) {
  queue_images(line, s, false);
  s.match_stereo(line.then("stereo"));
  s.forget_matches(line.then("result"));
  s.pack_keypoints(line.then("result"));
  s.pack_matches(line.with("result"), s.outcome_of_extract());
  line.end();
}

/// Images, keypoints, stereo, the search from the last frame and its pose.
/// @param local_follows queue_local() comes next, on the same line
template <typename Line, typename Stages>
void queue_motion(Line& line, Stages& s, bool local_follows) {
  queue_images(line, s, local_follows);
  if constexpr (Stages::rectified) {
    line.both([&](Line& l) { s.list_last_frame(l.then("search last frame")); },
              [&](Line& l) { s.match_stereo(l.with("stereo")); });
    s.assign_last_frame(line.then("search last frame"));
  } else {
    auto const branch = line.fork(s.stereo_branch());
    s.list_last_frame(line.then("search last frame"));
    s.match_stereo(line.on(branch));
    line.end_of_branch(branch, "stereo");
    s.assign_last_frame(line.then("search last frame"));
  }
  if (s.optimizes_last()) { s.optimize_last(line.then("pose last frame")); }
  if (!Stages::rectified && !(local_follows && s.lists_local_early())) {
    line.join(s.stereo_branch());
  }
}

/// The search in the local map and its pose, and the result.
/// @param early the preceding launch is the choice of the search from the last frame: a prologue
///   lists the local map's candidates concurrently
template <typename Line, typename Stages>
void queue_local(Line& line, Stages& s, bool early) {
  if (early) {
    s.list_local_map_early(line.then("search local map"));
    if (!Stages::rectified) { line.join(s.stereo_branch()); }
  } else {
    s.list_local_map(line.then("search local map"));
  }
  auto const branch = line.fork(s.result_branch());
  s.pack_visibility(branch);
  s.pack_keypoints(branch);
  s.assign_local_map(line.then("search local map"));
  if (s.optimizes_local()) { s.optimize_local(line.then("pose local map")); }
  line.join(s.result_branch());
  s.pack_matches(line.then("result"), s.outcome_of_local());
  line.end();
}

/// queue_motion() and the result.
template <typename Line, typename Stages>
void queue_track_motion(Line& line, Stages& s) {
  queue_motion(line, s, false);
  s.pack_keypoints(line.then("result"));
  s.pack_matches(line.with("result"), s.outcome_of_motion());
  line.end();
}

/// A whole frame.
template <typename Line, typename Stages>
void queue_track(Line& line, Stages& s) {
  queue_motion(line, s, true);
  queue_local(line, s, s.lists_local_early());
}

/// Only the search in the local map: of a frame that queue_track_motion() has enqueued, or from a
/// pose.
template <typename Line, typename Stages>
void queue_track_local(Line& line, Stages& s, bool restart) {
  s.upload_local(line.then("upload"), restart);
  queue_local(line, s, false);
}

}  // namespace detail
}  // namespace FT_ABI
}  // namespace ft

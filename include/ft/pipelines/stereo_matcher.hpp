// SPDX-License-Identifier: Apache-2.0
/// @file Pipeline: depth of the left keypoints of a batch of stereo pairs, in memory allocated
/// once.
#pragma once

#include <cstddef>
#include <type_traits>

#include "ft/cameras/image_domain.hpp"
#include "ft/cameras/stereo_rig.hpp"
#include "ft/containers/stereo_matches.hpp"
#include "ft/core/config.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/stereo/fisheye.hpp"
#include "ft/kernels/stereo/rectified.hpp"
#include "ft/pipelines/orb_extractor.hpp"

namespace ft {
inline namespace FT_ABI {

/// Stereo of images 2 b and 2 b + 1 of an extractor, pair b; pair b of a multi_rig of N cameras is
/// that of camera b modulo N. match() is asynchronous on the
/// executor, allocates nothing and never waits. Move-only. A moved-from matcher refuses every call
/// with bad_argument. Not thread-safe; instances are independent.
/// @tparam Rig rectified_rig, multi_rig, or stereo_rig of any two cameras (matched in their
/// overlap,
///   triangulated)
template <typename Exec, typename Rig = rectified_rig>
class stereo_matcher {
public:
  static constexpr memory_space space = Exec::space;

  stereo_matcher() = default;
  /// @throws bad_argument for an invalid rig, cameras that cannot be inverted in their images (see
  ///   require_invertible; a quarter of the pixels must have a ray), or an extractor whose batch is
  ///   not a multiple of the rig's images
  /// @param columns of rectified pairs
  stereo_matcher(Rig const& rig, orb_extractor<Exec> const& extractor,
                 column_rule columns = column_rule::parabola)
      : rig_(rig), columns_(columns) {
    rig.check();
    detail::require(extractor.batch() >= Rig::images && extractor.batch() % Rig::images == 0,
                    Rig::images == 2 ? "stereo needs an extractor with an even number of images"
                                     : "stereo needs an extractor with the images of whole rigs");
    if constexpr (!Rig::rectified) {
      require_invertible(rig.left, extractor.params().width, extractor.params().height, 0.25);
      require_invertible(rig.right, extractor.params().width, extractor.params().height, 0.25);
    }
    if constexpr (Rig::rectified) {
      for (int c = 0; c < Rig::cameras; ++c) {
        auto const& pair = rig.pair(c);
        if (pair.single()) { continue; }
        stereo_params& p = params_.of[c];
        p.bf = pair.bf();
        p.max_disparity = pair.bf() / pair.baseline_length().value;
      }
    }
    grid_geometry rows;
    rows.cols = 1;
    rows.rows = extractor.params().height;
    shape const of{extractor.batch() / 2, extractor.capacity(), rows.rows};
    memory_ = owner<memory, space>([&](carver& c, memory& m) {
      m.made_for = of;
      if constexpr (Rig::rectified) {
        carve(c, m.matches, of.capacity, of.pairs);
        carve(c, m.right_rows, rows, of.capacity, of.pairs);
      } else {
        carve(c, m.fisheye, of.capacity, of.pairs);
      }
    });
  }

  /// Enqueues the matching of the extractor's current images.
  /// @throws bad_argument, as match_sorted(), for an extractor of another shape than the
  ///   constructor's
  void match(Exec const& exec, orb_extractor<Exec> const& extractor) {
    require_shape(extractor);
    if constexpr (Rig::rectified) {
      sort_right_rows(exec, extractor.keypoints(), memory_->right_rows);
    }
    match_sorted(detail::with_order(exec, detail::launch_order::serial), extractor);
  }
  /// The same if another stage has already sorted the right keypoints of rectified pairs into
  /// right_rows(). Only the first launch is concurrent with its predecessor if `exec` says so.
  void match_sorted(Exec const& exec, orb_extractor<Exec> const& extractor) {
    require_shape(extractor);
    if constexpr (Rig::rectified) {
      if (columns_ == column_rule::least_squares) {
        match_rows<column_rule::least_squares>(exec, extractor);
      } else {
        match_rows<column_rule::parabola>(exec, extractor);
      }
    } else {
      match_stereo_fisheye(
          exec,
          fisheye_stereo<Rig>{rig_, extractor.geometry(), extractor.mono_count(), fisheye_params_},
          extractor.keypoints(), memory_->fisheye);
    }
  }
  /// Grid of the right keypoints by rows; without memory if the rig is not rectified.
  feature_grid_view right_rows() const { return memory_->right_rows; }

  // Executor memory, valid as long as the matcher.
  /// Rectified: one batch entry per pair.
  stereo_matches_view matches() const { return memory_->matches; }
  fisheye_matches_view fisheye_matches() const { return memory_->fisheye; }  ///< otherwise
  /// [pairs][capacity] depth of left keypoints, metres, -1 = none
  float const* depth() const {
    return Rig::rectified ? array_of<field::depth>(memory_->matches) : memory_->fisheye.depth;
  }
  row_facts rows() const {
    stereo_matches_view const& m = memory_->matches;
    if constexpr (!Rig::rectified) { return {}; }
    return {array_of<field::rival>(m), array_of<field::row_difference>(m)};
  }
  std::size_t bytes() const { return memory_.bytes(); }  ///< of executor memory
  /// Of camera c of a rig.
  stereo_params const& params(int c = 0) const { return params_.of_pair(c); }

private:
  struct shape {
    int pairs = 0;
    int capacity = 0;
    int height = 0;  ///< of images
  };
  struct memory {
    shape made_for;
    stereo_matches_view matches;
    feature_grid_view right_rows;
    fisheye_matches_view fisheye;
  };
  template <column_rule Rule>
  void match_rows(Exec const& exec, orb_extractor<Exec> const& extractor) {
    match_sorted_rows<Rule>(exec, extractor.pyramid(), extractor.keypoints(), params_,
                            memory_->matches, memory_->right_rows);
  }
  void require_shape(orb_extractor<Exec> const& extractor) const {
    memory_.require_made("stereo matcher");
    shape const of = memory_->made_for;
    detail::require(extractor.batch() == 2 * of.pairs && extractor.capacity() == of.capacity &&
                        extractor.params().height == of.height,
                    "the extractor's batch, capacity or image height is not that of the one that "
                    "the stereo matcher was made with");
  }

  Rig rig_{};
  rig_stereo_params<Rig::cameras> params_;
  column_rule columns_ = column_rule::parabola;
  fisheye_stereo_params fisheye_params_;
  owner<memory, space> memory_;
};

}  // namespace FT_ABI
}  // namespace ft

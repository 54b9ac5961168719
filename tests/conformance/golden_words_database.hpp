// SPDX-License-Identifier: Apache-2.0
/// @file Compares scores of bags of words, and queries of a keyframe database, with golden_words.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/containers/vocabulary.hpp"
#include "ft/kernels/words/score.hpp"
#include "tests/conformance/golden_sequence.hpp"
#include "tests/conformance/golden_words_transform.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/npy.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/word_database.hpp"

namespace test {

inline word_bag read_bag(std::string const& start) {
  return {read_npy<std::uint32_t>(start + "bow_word.npy").data,
          read_npy<double>(start + "bow_value.npy").data};
}

template <typename Exec>
double score_of_bags(Exec const& exec, word_bag const& a, word_bag const& b,
                     ft::word_scoring scoring) {
  word_bags<Exec> const lists(exec, {a, b});
  auto const pair = to_exec(exec, std::vector<ft::word_list_pair>{{0, 1}});
  auto const score = to_exec(exec, std::vector<double>{-1});
  ft::score_words(exec, lists.view(), lists.view(), {pair.data(), 1}, scoring, score.data());
  return from_exec(exec, score.data(), 1)[0];
}

/// Bags of words by the transform, with vocabulary kimera of another scoring and weighting.
template <typename Exec>
class golden_scores {
public:
  golden_scores(Exec const& exec, std::string const& folder)
      : exec_(exec), folder_(folder), vocabulary_(golden_vocabulary(folder, "kimera")) {}

  void run(stage_result& r) {
    for (int s = 0; s < 6; ++s) {
      for (int w = 0; w < 4; ++w) {
        vocabulary_.header.scoring = static_cast<ft::word_scoring>(s);
        vocabulary_.header.weighting = static_cast<ft::word_weighting>(w);
        auto const made = ft::upload(exec_, ft::make_vocabulary(vocabulary_.arrays()).view());
        double const got =
            score_of_bags(exec_, bag_of(made.view(), "euroc_mono_0"),
                          bag_of(made.view(), "euroc_mono_1"), vocabulary_.header.scoring);
        double const want = read_npy<double>(folder_ + "/scoring/s" + std::to_string(s) + "_w" +
                                             std::to_string(w) + "_score.npy")(0);
        r.add(got == want, got - want);
      }
    }
  }

private:
  word_bag bag_of(ft::vocabulary_view const& vocabulary, std::string const& frame) const {
    auto const orb =
        descriptors_of(read_npy<std::uint8_t>(folder_ + "/frames/" + frame + "/desc.npy"));
    auto const words = words_of(exec_, vocabulary, orb, 4);
    return {words.bag_word, words.bag_value};
  }

  Exec exec_;
  std::string folder_;
  plain_vocabulary vocabulary_;
};

/// A recorded database, and its queries one after the other.
template <typename Exec>
class golden_database {
public:
  golden_database(Exec const& exec, std::string const& folder)
      : start_(read_npy<std::int32_t>(folder + "/kf_start.npy").data),
        ids_(start_.size() - 1),
        database_(exec, static_cast<int>(ids_.size()), longest(), 1 << 20) {
    auto const map = read_npy<std::int32_t>(folder + "/kf_map.npy");
    word_bag const all{read_npy<std::uint32_t>(folder + "/kf_word.npy").data,
                       read_npy<double>(folder + "/kf_value.npy").data};
    for (int const k : read_npy<std::int32_t>(folder + "/insert_order.npy").data) {
      auto const at = static_cast<std::size_t>(k);
      auto const from = start_[at];
      auto const to = start_[at + 1];
      ids_[at] = database_.add({{all.word.begin() + from, all.word.begin() + to},
                                {all.value.begin() + from, all.value.begin() + to}},
                               map(k));
    }
    auto const cov = read_npy<std::int32_t>(folder + "/cov.npy");
    auto const cov_start = read_npy<std::int32_t>(folder + "/cov_start.npy");
    for (int k = 0; k < keyframes(); ++k) {
      std::vector<ft::keyframe_id> neighbours;
      for (int i = cov_start(k); i < cov_start(k + 1); ++i) {
        if (neighbours.size() < 10) {
          neighbours.push_back(ids_[static_cast<std::size_t>(cov(i))]);
        }
      }
      database_.set_neighbours(ids_[static_cast<std::size_t>(k)], neighbours);
    }
    for (int const k : read_npy<std::int32_t>(folder + "/erased.npy").data) {
      database_.erase(ids_[static_cast<std::size_t>(k)]);
      ids_[static_cast<std::size_t>(k)] = {};
    }
  }

  void compare(std::string const& folder, conformance_table& table) {
    answered const got = database_.query({read_bag(folder + "/")}, {0});
    auto const common = read_npy<std::int32_t>(folder + "/common.npy");
    auto const after = read_npy<float>(folder + "/score_after.npy");
    auto const result = read_npy<std::int32_t>(folder + "/result.npy");
    for (int k = 0; k < keyframes(); ++k) {
      ft::keyframe_id const id = ids_[static_cast<std::size_t>(k)];
      if (id.number == 0) { continue; }
      auto const slot = static_cast<std::size_t>(id.slot);
      table["database_common"].add(got.common[0][slot] == common(k));
      table["database_score"].add(got.score[0][slot] == after(k),
                                  static_cast<double>(got.score[0][slot] - after(k)));
    }
    auto const& places = got.places[0];
    table["database_query"].add(static_cast<int>(places.size()) == result.rows());
    for (int i = 0; i < result.rows(); ++i) {
      table["database_query"].add(static_cast<std::size_t>(i) < places.size() &&
                                  places[static_cast<std::size_t>(i)].keyframe ==
                                      ids_[static_cast<std::size_t>(result(i))]);
    }
  }

private:
  int keyframes() const { return static_cast<int>(ids_.size()); }
  int longest() const {
    int most = 1;
    for (std::size_t k = 1; k < start_.size(); ++k) {
      most = std::max(most, start_[k] - start_[k - 1]);
    }
    return most;
  }

  std::vector<int> start_;
  std::vector<ft::keyframe_id> ids_;
  word_database<Exec> database_;
};

/// A recorded database and all its queries.
template <typename Exec>
void compare_database(Exec const& exec, std::string const& folder, conformance_table& table) {
  golden_database<Exec> database(exec, folder);
  for (int q = 0; exists(folder + "/query_" + std::to_string(q) + "/result.npy"); ++q) {
    database.compare(folder + "/query_" + std::to_string(q), table);
  }
}

}  // namespace test

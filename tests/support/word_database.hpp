// SPDX-License-Identifier: Apache-2.0
/// @file Bags of words on the host, and a database of them in an executor's memory.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "ft/containers/keyframe_database.hpp"
#include "ft/containers/words.hpp"
#include "ft/core/execution.hpp"
#include "ft/kernels/words/query_database.hpp"
#include "ft/kernels/words/score.hpp"
#include "tests/support/memory.hpp"

namespace test {

/// The words of a frame, ascending.
struct word_bag {
  std::vector<std::uint32_t> word;
  std::vector<double> value;
};

/// Bags of words in an executor's memory.
template <typename Exec>
class word_bags {
public:
  /// @param capacity of a frame; at least as many as the largest has, and at least 1
  word_bags(Exec const& exec, std::vector<word_bag> const& bags, int capacity = 1) {
    std::size_t wide = static_cast<std::size_t>(capacity);
    for (auto const& b : bags) { wide = std::max(wide, b.word.size()); }
    std::vector<int> count;
    std::vector<std::uint32_t> word(wide * bags.size(), 0xffffffffu);
    std::vector<double> value(wide * bags.size(), -1e300);
    for (std::size_t i = 0; i < bags.size(); ++i) {
      count.push_back(static_cast<int>(bags[i].word.size()));
      std::copy(bags[i].word.begin(), bags[i].word.end(),
                word.begin() + static_cast<std::ptrdiff_t>(i * wide));
      std::copy(bags[i].value.begin(), bags[i].value.end(),
                value.begin() + static_cast<std::ptrdiff_t>(i * wide));
    }
    memory_ = ft::owner<ft::word_list_view, Exec::space>([&](ft::carver& c, auto& v) {
      carve(c, v, static_cast<int>(bags.size()), static_cast<int>(wide));
    });
    ft::copy(exec, memory_->count, count.data(), count.size());
    ft::copy(exec, memory_->word, word.data(), word.size());
    ft::copy(exec, memory_->value, value.data(), value.size());
    exec.wait();
  }
  ft::word_list_view const& view() const { return memory_.view(); }

private:
  ft::owner<ft::word_list_view, Exec::space> memory_;
};

/// What a batch of queries answered, counted and scored.
struct answered {
  std::vector<std::vector<ft::place_candidate>> places;
  std::vector<std::vector<int>> common;   ///< by query and slot
  std::vector<std::vector<float>> score;  ///< the same; of slots that are in use
};

/// A database with the memory of its queries.
template <typename Exec>
class word_database {
public:
  word_database(Exec const& exec, int capacity, int row, int vocabulary)
      : exec_(exec), slots_(capacity) {
    ft::keyframe_database_view sizes;
    sizes.capacity = capacity;
    sizes.row = row;
    sizes.vocabulary = vocabulary;
    memory_ = ft::owner<ft::keyframe_database_view, Exec::space>(
        [](ft::carver& c, auto& v) { carve(c, v); }, sizes);
    clear(exec_, view());
  }

  ft::keyframe_id add(ft::word_list_view const& lists, int frame, int map = 0) {
    ft::keyframe_id const id = slots_.take();
    insert_keyframe(exec_, lists, {id, frame, map}, view());
    return id;
  }
  ft::keyframe_id add(word_bag const& bag, int map = 0) {
    word_bags<Exec> const lists(exec_, {bag});
    auto const id = add(lists.view(), 0, map);
    exec_.wait();
    return id;
  }
  void erase(ft::keyframe_id id) {
    slots_.release(id);
    erase_keyframe(exec_, id, view());
  }
  void set_neighbours(ft::keyframe_id id, std::vector<ft::keyframe_id> const& ids) {
    ft::keyframe_neighbours n;
    n.count = static_cast<int>(ids.size());
    std::copy(ids.begin(), ids.end(), n.of);
    ft::set_neighbours(exec_, id, n, view());
  }

  answered query(std::vector<word_bag> const& bags, std::vector<int> const& maps,
                 ft::word_scoring scoring = ft::word_scoring::l1) {
    word_bags<Exec> const lists(exec_, bags);
    auto const d_maps = to_exec(exec_, maps);
    int const queries = static_cast<int>(bags.size());
    ft::owner<ft::query_workspace, Exec::space> const work(
        [&](ft::carver& c, auto& v) { carve(c, v, queries, view()); });
    ft::owner<ft::place_candidates_view, Exec::space> const found(
        [&](ft::carver& c, auto& v) { carve(c, v, queries, slots_.capacity()); });
    query_database(exec_, {lists.view(), d_maps.data()}, view(), scoring, found.view(),
                   work.view());
    answered got;
    auto const count = from_exec(exec_, found->count, bags.size());
    auto const n = static_cast<std::size_t>(slots_.capacity());
    for (int q = 0; q < queries; ++q) {
      auto const places = static_cast<std::size_t>(count[static_cast<std::size_t>(q)]);
      got.places.push_back(from_exec(exec_, found->of + found->at(q), places));
      got.common.push_back(from_exec(exec_, work->common + work->at(q), n));
      got.score.push_back(from_exec(exec_, work->score + work->at(q), n));
    }
    return got;
  }

  ft::keyframe_database_view const& view() const { return memory_.view(); }
  ft::keyframe_slots const& slots() const { return slots_; }

private:
  Exec exec_;
  ft::keyframe_slots slots_;
  ft::owner<ft::keyframe_database_view, Exec::space> memory_;
};

}  // namespace test

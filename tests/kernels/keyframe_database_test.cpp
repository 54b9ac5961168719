// SPDX-License-Identifier: Apache-2.0
// Database of keyframes: queries against an inverted index, with erasures, slots used again,
// several maps and batches; ties; ids; bad input.
#include "ft/kernels/words/query_database.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <list>
#include <map>
#include <random>
#include <string>
#include <utility>
#include <vector>

#include "tests/support/backends.hpp"
#include "tests/support/memory.hpp"
#include "tests/support/word_database.hpp"

namespace keyframe_database_test {

using ft::word_scoring;
using test::word_bag;

/// A keyframe as the rule knows it.
struct plain_keyframe {
  ft::keyframe_id id;
  std::map<std::uint32_t, double> words;
  std::vector<int> neighbours;  ///< names
  int map = 0;
  float score = 0;
};

struct plain_answer {
  std::vector<int> names;
  std::vector<float> group_scores;
};

/// An inverted index, with lists of keyframes by word in order of insertion.
class plain_database {
public:
  std::map<int, plain_keyframe> keyframes;
  std::map<int, int> common;  ///< of the last query

  void add(int name, plain_keyframe const& k) {
    keyframes[name] = k;
    for (auto const& w : k.words) { lists_[w.first].push_back(name); }
  }
  void erase(int name) {
    for (auto const& w : keyframes[name].words) { lists_[w.first].remove(name); }
    keyframes.erase(name);
  }

  plain_answer query(std::map<std::uint32_t, double> const& words, int map) {
    common.clear();
    std::vector<int> order;
    int most = 0;
    for (auto const& w : words) {
      auto const list = lists_.find(w.first);
      if (list == lists_.end()) { continue; }
      for (int const name : list->second) {
        if (++common[name] == 1) { order.push_back(name); }
        most = std::max(most, common[name]);
      }
    }
    int const least = static_cast<int>(static_cast<float>(most) * 0.8f);
    std::vector<int> kept;
    for (int const name : order) {
      if (common[name] <= least) { continue; }
      keyframes[name].score = static_cast<float>(score(words, keyframes[name].words));
      kept.push_back(name);
    }
    std::vector<float> sums;
    std::vector<int> bests;
    for (int const name : kept) {
      float sum = keyframes[name].score;
      float highest = sum;
      int best = name;
      for (int const other : keyframes[name].neighbours) {
        if (keyframes.count(other) == 0 || common.count(other) == 0) { continue; }
        sum += keyframes[other].score;
        if (keyframes[other].score > highest) {
          highest = keyframes[other].score;
          best = other;
        }
      }
      sums.push_back(sum);
      bests.push_back(best);
    }
    plain_answer answer;
    if (kept.empty()) { return answer; }
    float const limit = 0.75f * *std::max_element(sums.begin(), sums.end());
    for (std::size_t i = 0; i < kept.size(); ++i) {
      auto& names = answer.names;
      if (sums[i] > limit && keyframes[bests[i]].map == map &&
          std::find(names.begin(), names.end(), bests[i]) == names.end()) {
        names.push_back(bests[i]);
        answer.group_scores.push_back(sums[i]);
      }
    }
    return answer;
  }

private:
  /// L1.
  static double score(std::map<std::uint32_t, double> const& a,
                      std::map<std::uint32_t, double> const& b) {
    double sum = 0;
    for (auto const& [word, v] : a) {
      auto const w = b.find(word);
      if (w != b.end()) { sum += std::abs(v - w->second) - std::abs(v) - std::abs(w->second); }
    }
    return -sum / 2.0;
  }

  std::map<std::uint32_t, std::list<int>> lists_;
};

std::map<std::uint32_t, double> random_words(std::mt19937& random, int count, std::uint32_t among,
                                             bool equal) {
  std::uniform_int_distribution<std::uint32_t> pick(0, among - 1);
  std::uniform_int_distribution<int> rare(1, 6);
  std::map<std::uint32_t, double> words;
  double sum = 0;
  while (static_cast<int>(words.size()) < count) { words[pick(random)] = equal ? 1 : rare(random); }
  for (auto const& w : words) { sum += w.second; }
  for (auto& w : words) { w.second /= sum; }
  return words;
}

word_bag flat(std::map<std::uint32_t, double> const& words) {
  word_bag bag;
  for (auto const& [word, value] : words) {
    bag.word.push_back(word);
    bag.value.push_back(value);
  }
  return bag;
}

/// The database under test and the plain one, changed together.
template <typename Exec>
struct both_databases {
  static constexpr int row = 70;

  std::mt19937 random;
  std::uint32_t words;
  bool equal;
  test::word_database<Exec> tested;
  plain_database plain;
  int names = 0;

  both_databases(Exec const& exec, unsigned seed, int capacity, std::uint32_t vocabulary, bool same)
      : random(seed),
        words(vocabulary),
        equal(same),
        tested(exec, capacity, row, static_cast<int>(vocabulary)) {}

  int below(int n) { return static_cast<int>(random() % static_cast<unsigned>(n)); }
  int any_name() {
    auto at = plain.keyframes.begin();
    std::advance(at, below(static_cast<int>(plain.keyframes.size())));
    return at->first;
  }

  void add() {
    plain_keyframe k;
    int const most = std::min(row, static_cast<int>(words));
    k.words = random_words(random, below(8) == 0 ? 0 : 1 + below(most), words, equal);
    k.map = below(2);
    k.id = tested.add(flat(k.words), k.map);
    plain.add(names++, k);
  }
  void erase() {
    int const name = any_name();
    tested.erase(plain.keyframes[name].id);
    plain.erase(name);
  }
  /// Neighbours, of which some may be erased later.
  void connect() {
    int const name = any_name();
    std::vector<ft::keyframe_id> ids;
    auto& neighbours = plain.keyframes[name].neighbours;
    neighbours.clear();
    for (int i = below(11); i > 0; --i) {
      neighbours.push_back(any_name());
      ids.push_back(plain.keyframes[neighbours.back()].id);
    }
    tested.set_neighbours(plain.keyframes[name].id, ids);
  }
  void query(int batch) {
    std::vector<word_bag> bags;
    std::vector<std::map<std::uint32_t, double>> wanted;
    std::vector<int> maps;
    for (int q = 0; q < batch; ++q) {
      int const most = std::min(row, static_cast<int>(words));
      wanted.push_back(random_words(random, q % 5 == 4 ? 0 : 1 + below(most), words, equal));
      bags.push_back(flat(wanted.back()));
      maps.push_back(below(2));
    }
    auto const got = tested.query(bags, maps);
    for (int q = 0; q < batch; ++q) {
      auto const at = static_cast<std::size_t>(q);
      SCOPED_TRACE("query " + std::to_string(q));
      auto const want = plain.query(wanted[at], maps[at]);
      compare(got, at, want);
    }
  }
  void compare(test::answered const& got, std::size_t q, plain_answer const& want) {
    for (auto const& [name, k] : plain.keyframes) {
      auto const slot = static_cast<std::size_t>(k.id.slot);
      auto const common = plain.common.find(name);
      EXPECT_EQ(got.common[q][slot], common == plain.common.end() ? 0 : common->second);
      EXPECT_EQ(got.score[q][slot], k.score);
    }
    auto const& places = got.places[q];
    ASSERT_EQ(places.size(), want.names.size());
    for (std::size_t i = 0; i < places.size(); ++i) {
      auto const& k = plain.keyframes[want.names[i]];
      EXPECT_EQ(places[i].keyframe, k.id) << "place " << i;
      EXPECT_EQ(places[i].score, k.score);
      EXPECT_EQ(places[i].group_score, want.group_scores[i]);
    }
  }
};

template <typename Backend>
class KeyframeDatabase : public test::on_backend<Backend> {};
TYPED_TEST_SUITE(KeyframeDatabase, test::backends);

TYPED_TEST(KeyframeDatabase, AnswersAsAnInvertedIndex) {
  TypeParam backend;
  unsigned seed = 1;
  for (std::uint32_t const words : {3u, 33u, 90u, 1000u}) {
    for (bool const equal : {false, true}) {
      both_databases<typename TypeParam::exec_type> both(backend.exec, ++seed, 40, words, equal);
      both.query(1);  // empty
      for (int step = 0; step < test::effort(60); ++step) {
        int const size = both.tested.slots().size();
        if (size < 40 && (size == 0 || both.below(3) > 0)) { both.add(); }
        if (size == 40 || (size > 5 && both.below(6) == 0)) { both.erase(); }
        both.connect();
        if (step % 3 == 0) { both.query(1 + both.below(6)); }
        if (this->HasFatalFailure()) { return; }
      }
    }
  }
}

TYPED_TEST(KeyframeDatabase, OfMoreSlotsThanABlockHasThreads) {
  TypeParam backend;
  both_databases<typename TypeParam::exec_type> both(backend.exec, 50, 1300, 60, false);
  for (int i = 0; i < 1300; ++i) { both.add(); }
  for (int i = 0; i < 400; ++i) { both.connect(); }
  for (int i = 0; i < 100; ++i) { both.erase(); }
  both.query(4);
}

TYPED_TEST(KeyframeDatabase, OrdersByFirstSharedWordThenByInsertion) {
  TypeParam backend;
  test::word_database<typename TypeParam::exec_type> database(backend.exec, 8, 4, 100);
  word_bag const late{{5, 9}, {0.5, 0.5}};
  word_bag const early{{2, 9}, {0.5, 0.5}};
  auto const a = database.add(late);
  auto const b = database.add(early);
  auto const c = database.add(late);
  auto const d = database.add(early);
  database.erase(a);
  auto const e = database.add(late);  // in the slot of a
  EXPECT_EQ(e.slot, a.slot);
  EXPECT_FALSE(e == a);
  auto const places = database.query({{{2, 5, 9}, {0.25, 0.25, 0.5}}}, {0}).places[0];
  ASSERT_EQ(places.size(), 4u);
  EXPECT_EQ(places[0].keyframe, b);
  EXPECT_EQ(places[1].keyframe, d);
  EXPECT_EQ(places[2].keyframe, c);
  EXPECT_EQ(places[3].keyframe, e);
}

TYPED_TEST(KeyframeDatabase, WordsThatTheVocabularyLacksAreNotShared) {
  TypeParam backend;
  for (int const vocabulary : {32, 33, 40}) {
    test::word_database<typename TypeParam::exec_type> database(backend.exec, 3, 6, vocabulary);
    auto const end = static_cast<std::uint32_t>(vocabulary);
    auto const a = database.add({{end - 1, end, end + 1, 0xffffffffu}, {0.25, 0.25, 0.25, 0.25}});
    auto const b = database.add({{end, end + 1, 0xffffffffu}, {0.5, 0.25, 0.25}});
    auto const got = database.query(
        {{{end - 1, end, end + 1, 0xffffffffu}, {0.25, 0.25, 0.25, 0.25}}, {{end}, {1.0}}}, {0, 0});
    EXPECT_EQ(got.common[0][static_cast<std::size_t>(a.slot)], 1);
    EXPECT_EQ(got.common[0][static_cast<std::size_t>(b.slot)], 0);
    EXPECT_EQ(got.common[1][static_cast<std::size_t>(a.slot)], 0);
    ASSERT_EQ(got.places[0].size(), 1u);
    EXPECT_EQ(got.places[0][0].keyframe, a);
    EXPECT_TRUE(got.places[1].empty());
  }
}

TYPED_TEST(KeyframeDatabase, NeighbourThatWasErasedIsNotTheOneInItsSlot) {
  TypeParam backend;
  test::word_database<typename TypeParam::exec_type> database(backend.exec, 3, 4, 100);
  word_bag const bag{{1, 2}, {0.5, 0.5}};
  auto const a = database.add(bag);
  auto const b = database.add(bag);
  database.set_neighbours(a, {b});
  EXPECT_EQ(database.query({bag}, {0}).places[0][0].group_score, 2.0f);
  database.erase(b);
  EXPECT_EQ(database.query({bag}, {0}).places[0][0].group_score, 1.0f);
  auto const c = database.add(bag);
  EXPECT_EQ(c.slot, b.slot);
  EXPECT_EQ(database.query({bag}, {0}).places[0][0].group_score, 1.0f);
  // Nor does it take the erased one's place in calls.
  database.set_neighbours(a, {c});
  database.set_neighbours(c, {a});
  erase_keyframe(backend.exec, b, database.view());
  ft::set_neighbours(backend.exec, b, {}, database.view());
  move_keyframe(backend.exec, b, 7, database.view());
  auto const places = database.query({bag}, {0}).places[0];
  ASSERT_EQ(places.size(), 2u);
  EXPECT_EQ(places[0].group_score, 2.0f);
  EXPECT_EQ(places[1].keyframe, c);
  move_keyframe(backend.exec, c, 7, database.view());
  EXPECT_EQ(database.query({bag}, {0}).places[0].size(), 1u);
  EXPECT_EQ(database.query({bag}, {7}).places[0].size(), 1u);
}

TYPED_TEST(KeyframeDatabase, ScoresThatAreNotNumbersNameNothing) {
  TypeParam backend;
  test::word_database<typename TypeParam::exec_type> database(backend.exec, 3, 4, 100);
  double const nan = std::nan("");
  database.add({{1, 2}, {nan, nan}});
  auto const good = database.add({{1, 2}, {0.5, 0.5}});
  auto const places = database.query({{{1, 2}, {0.5, 0.5}}}, {0}).places[0];
  ASSERT_EQ(places.size(), 1u);
  EXPECT_EQ(places[0].keyframe, good);
}

TYPED_TEST(KeyframeDatabase, TakesEveryScoring) {
  TypeParam backend;
  for (int s = 0; s < 6; ++s) {
    test::word_database<typename TypeParam::exec_type> database(backend.exec, 3, 4, 100);
    auto const a = database.add({{1, 2, 3}, {0.5, 0.2, 0.3}});
    word_bag const query{{1, 3, 4}, {0.4, 0.2, 0.4}};
    auto const got = database.query({query}, {0}, static_cast<word_scoring>(s));
    double const expected[] = {
        0.6,
        1 - std::sqrt(1 - 0.26),
        2 * (0.2 / 0.9 + 0.06 / 0.5),
        0.4 * std::log(0.8) + 0.2 * std::log(0.2 / 0.3) + 0.4 * std::log(0.4 * 0x1p52),
        std::sqrt(0.2) + std::sqrt(0.06),
        0.26};
    ASSERT_EQ(got.places[0].size(), 1u) << s;
    EXPECT_EQ(got.places[0][0].keyframe, a);
    EXPECT_NEAR(static_cast<double>(got.places[0][0].score), expected[s],
                1e-6 * std::max(1.0, expected[s]));
  }
}

TYPED_TEST(KeyframeDatabase, RefusesBadInput) {
  TypeParam backend;
  using exec_type = typename TypeParam::exec_type;
  exec_type const& exec = backend.exec;
  test::word_database<exec_type> database(exec, 3, 4, 100);
  test::word_bags<exec_type> const lists(exec, {{{1}, {1.0}}}, 4);
  test::word_bags<exec_type> const wide(exec, {{{1}, {1.0}}}, 5);
  auto const& view = database.view();
  EXPECT_THROW(insert_keyframe(exec, wide.view(), {{0, 1}, 0, 0}, view), ft::bad_argument);
  EXPECT_THROW(insert_keyframe(exec, {}, {{0, 1}, 0, 0}, view), ft::bad_argument);
  EXPECT_THROW(insert_keyframe(exec, lists.view(), {{0, 1}, 1, 0}, view), ft::bad_argument);
  EXPECT_THROW(insert_keyframe(exec, lists.view(), {{3, 1}, 0, 0}, view), ft::bad_argument);
  EXPECT_THROW(insert_keyframe(exec, lists.view(), {{0, 0}, 0, 0}, view), ft::bad_argument);
  EXPECT_THROW(erase_keyframe(exec, {-1, 1}, view), ft::bad_argument);
  EXPECT_THROW(erase_keyframe(exec, {0, 1}, {}), ft::bad_argument);
  ft::keyframe_neighbours many;
  many.count = 11;
  EXPECT_THROW(ft::set_neighbours(exec, {0, 1}, many, view), ft::bad_argument);
  EXPECT_THROW((test::word_database<exec_type>(exec, 0, 4, 100)), ft::bad_argument);
  EXPECT_THROW((test::word_database<exec_type>(exec, 3, 0, 100)), ft::bad_argument);
  EXPECT_THROW((test::word_database<exec_type>(exec, 3, 4, 0)), ft::bad_argument);

  auto const maps = test::to_exec(exec, std::vector<int>{0, 0});
  ft::owner<ft::query_workspace, exec_type::space> const work(
      [&](ft::carver& c, auto& v) { carve(c, v, 1, view); });
  ft::owner<ft::place_candidates_view, exec_type::space> const found(
      [&](ft::carver& c, auto& v) { carve(c, v, 1, 3); });
  ft::owner<ft::place_candidates_view, exec_type::space> const small(
      [&](ft::carver& c, auto& v) { carve(c, v, 1, 2); });
  auto const call = [&](ft::word_list_view const& l, int const* map, auto const& out) {
    query_database(exec, {l, map}, view, word_scoring::l1, out.view(), work.view());
  };
  EXPECT_NO_THROW(call(lists.view(), maps.data(), found));
  EXPECT_NO_THROW(call(wide.view(), maps.data(), found));
  EXPECT_THROW(call(lists.view(), nullptr, found), ft::bad_argument);
  EXPECT_THROW(call({}, maps.data(), found), ft::bad_argument);
  EXPECT_THROW(call(lists.view(), maps.data(), small), ft::bad_argument);
  test::word_bags<exec_type> const two(exec, {{{1}, {1.0}}, {{1}, {1.0}}});
  EXPECT_THROW(call(two.view(), maps.data(), found), ft::bad_argument);
  exec.wait();
}

TEST(KeyframeSlots, AreUsedAgainWithOtherNumbers) {
  ft::keyframe_slots slots(2);
  EXPECT_EQ(slots.size(), 0);
  auto const a = slots.take();
  auto const next = slots.next();
  EXPECT_EQ(slots.take(), next);
  EXPECT_EQ(slots.size(), 2);
  EXPECT_THROW(slots.next(), ft::error);
  EXPECT_THROW(slots.take(), ft::error);
  EXPECT_EQ(slots.size(), 2);
  slots.release(a);
  EXPECT_FALSE(slots.contains(a));
  EXPECT_THROW(slots.release(a), ft::bad_argument);
  auto const c = slots.take();
  EXPECT_EQ(c.slot, a.slot);
  EXPECT_FALSE(c == a);
  EXPECT_FALSE(slots.contains(a));
  EXPECT_TRUE(slots.contains(c));
  for (ft::keyframe_id const none : {ft::keyframe_id{}, ft::keyframe_id{0, 0},
                                     ft::keyframe_id{2, 1}, ft::keyframe_id{-1, c.number}}) {
    EXPECT_FALSE(slots.contains(none));
    EXPECT_THROW(slots.require(none), ft::bad_argument);
  }
  EXPECT_THROW(ft::keyframe_slots(0), ft::bad_argument);
}

}  // namespace keyframe_database_test

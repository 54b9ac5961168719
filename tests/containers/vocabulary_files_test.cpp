// SPDX-License-Identifier: Apache-2.0
// Vocabularies from text and from files of ft's own: read back whole, or refused.
#include "ft/containers/vocabulary_files.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdio>
#include <cstring>
#include <istream>
#include <locale>
#include <sstream>
#include <streambuf>
#include <string>
#include <utility>
#include <vector>

#include "ft/containers/vocabulary.hpp"
#include "ft/containers/vocabulary_text.hpp"
#include "ft/core/error.hpp"
#include "tests/support/effort.hpp"
#include "tests/support/plain_vocabulary.hpp"
#include "tests/support/random.hpp"
#include "tests/support/refusals.hpp"

namespace vocabulary_files_test {

using test::at;
using test::generator;
using test::plain_vocabulary;
using host_vocabulary = ft::vocabulary<ft::memory_space::host>;

/// The text form. Words must be numbered by their nodes.
std::string text_of(plain_vocabulary const& v) {
  std::string text = std::to_string(v.header.branching) + " " + std::to_string(v.header.levels) +
                     "  " + std::to_string(static_cast<int>(v.header.scoring)) + " " +
                     std::to_string(static_cast<int>(v.header.weighting));
  for (int i = 1; i < v.nodes(); ++i) {
    text += "\n" + std::to_string(v.parent[at(i)]) + (v.word[at(i)] >= 0 ? " 1" : " 0");
    for (std::uint32_t const w : v.orb[at(i)].words) {
      for (int shift = 0; shift < 32; shift += 8) {
        text += " " + std::to_string(w >> shift & 255);
      }
    }
    char weight[40];
    std::snprintf(weight, sizeof weight, "  %.17g", v.weight[at(i)]);
    text += weight;
  }
  return text;
}
plain_vocabulary with_words_by_node(plain_vocabulary v) {
  int words = 0;
  for (int& w : v.word) { w = w >= 0 ? words++ : -1; }
  return v;
}
host_vocabulary read_text(std::string const& text) {
  std::istringstream in(text);
  return ft::read_vocabulary_text(in);
}
std::string file_of(ft::vocabulary_view const& v) {
  std::ostringstream out;
  ft::save_vocabulary(out, v);
  return out.str();
}
host_vocabulary load(std::string const& file) {
  std::istringstream in(file);
  return ft::load_vocabulary(in);
}
/// What a reader says about a file; empty if it reads it.
template <typename Reader>
std::string refusal(Reader const& read, std::string const& file) {
  return test::refusal<ft::error>([&] { read(file); });
}

void expect_same(ft::vocabulary_view const& a, ft::vocabulary_view const& b) {
  ASSERT_EQ(a.nodes, b.nodes);
  EXPECT_EQ(a.words, b.words);
  EXPECT_EQ(a.header.branching, b.header.branching);
  EXPECT_EQ(a.header.levels, b.header.levels);
  EXPECT_EQ(a.header.scoring, b.header.scoring);
  EXPECT_EQ(a.header.weighting, b.header.weighting);
  auto const same = [&](auto const* x, auto const* y) {
    return std::memcmp(x, y, at(a.nodes) * sizeof *x) == 0;
  };
  EXPECT_TRUE(same(a.children, b.children));
  EXPECT_TRUE(same(a.orb, b.orb));
  EXPECT_TRUE(same(a.weight, b.weight));
  EXPECT_TRUE(same(a.word, b.word));
  EXPECT_TRUE(same(a.node, b.node));
}

/// A stream that cannot be positioned, as a pipe.
class one_way : public std::streambuf {
public:
  explicit one_way(std::string bytes) : bytes_(std::move(bytes)) {
    setg(bytes_.data(), bytes_.data(), bytes_.data() + bytes_.size());
  }

private:
  std::string bytes_;
};

std::vector<plain_vocabulary> several() {
  generator random(11);
  std::vector<plain_vocabulary> all(1);  // the root alone
  all.push_back(test::drawn_vocabulary(20, 1));
  for (int round = 0; round < test::effort(30); ++round) {
    auto v = test::random_vocabulary(random, random.from_to(1, 6), random.from_to(1, 4),
                                     random.below(40));
    v.header.scoring = static_cast<ft::word_scoring>(round % 6);
    v.header.weighting = static_cast<ft::word_weighting>(round % 4);
    all.push_back(v);
  }
  return all;
}

TEST(VocabularyText, IsReadBack) {
  for (auto const& any : several()) {
    auto const v = with_words_by_node(any);
    expect_same(read_text(text_of(v)).view(), ft::make_vocabulary(v.arrays()).view());
  }
}

TEST(VocabularyText, SkipsBlankLinesAndSpace) {
  generator random(12);
  auto const v = with_words_by_node(test::random_vocabulary(random, 3, 2, 0));
  auto const want = ft::make_vocabulary(v.arrays());
  std::string spaced = "\n \r\n";
  for (char const c : text_of(v)) {
    spaced += c == '\n'  ? std::string(" \t\r\n\n  \n")
              : c == ' ' ? std::string(" \t")
                         : std::string(1, c);
  }
  expect_same(read_text(spaced).view(), want.view());
  expect_same(read_text(text_of(v) + "\n").view(), want.view());
  one_way pipe(text_of(v));
  std::istream in(&pipe);
  expect_same(ft::read_vocabulary_text(in).view(), want.view());
}

TEST(VocabularyText, SaysWhichLineIsWrong) {
  std::string const bytes = [] {
    std::string row;
    for (int i = 0; i < 32; ++i) { row += " " + std::to_string(8 * i); }
    return row;
  }();
  std::string const good = "2 1 0 0\n0 1" + bytes + " 0.5\n0 1" + bytes + " 1e-3";
  ASSERT_EQ(read_text(good)->words, 2);
  EXPECT_EQ(read_text(good)->weight[2], 1e-3);
  struct fault {
    std::string text;
    char const* message;
  };
  std::string const head = "2 1 0 0\n";
  std::vector<fault> const faults{
      {"", "text is empty"},
      {" \n\n", "text is empty"},
      {"2 1 0", "line 1 of the vocabulary has '' instead of an integer, the weighting"},
      {"2 1 0 0 0", "line 1 of the vocabulary has '0' instead of the end of the line"},
      {"21 1 0 0",
       "line 1 of the vocabulary has '21' instead of the branching, must be in [0, 20]"},
      {"2 0 0 0", "the levels, must be in [1, 10]"},
      {"2 1 6 0", "the scoring, must be in [0, 5]"},
      {"2 1 0 -1", "'-1' instead of the weighting"},
      {"k 1 0 0", "'k' instead of an integer, the branching"},
      {"2.5 1 0 0", "'2.5' instead of an integer"},
      {"99999999999999999999 1 0 0", "instead of an integer"},
      {head + "\n\n1 1" + bytes + " 1", "line 4 of the vocabulary has '1' instead of the parent"},
      {head + "-1 1" + bytes + " 1", "line 2 of the vocabulary has '-1' instead of the parent"},
      {head + "0 x" + bytes + " 1", "'x' instead of an integer, whether the node is a leaf"},
      {head + "0 1 256" + bytes + " 1", "'256' instead of a byte of the descriptor"},
      {head + "0 1 -1" + bytes + " 1", "'-1' instead of a byte of the descriptor"},
      {head + "0 1" + bytes, "line 2 of the vocabulary has '' instead of a finite number"},
      {head + "0 1" + bytes + " nan", "'nan' instead of a finite number, the weight"},
      {head + "0 1" + bytes + " inf", "'inf' instead of a finite number"},
      {head + "0 1" + bytes + " 1e999", "'1e999' instead of a finite number"},
      {head + "0 1" + bytes + " 0.5x", "'0.5x' instead of a finite number"},
      {head + "0 1" + bytes + " 1,5", "'1,5' instead of a finite number"},
      {head + "0 1" + bytes + " 1 7", "'7' instead of the end of the line"},
      {head + "0 1 1\n2", "line 2 of the vocabulary has '' instead of an integer, a byte"},
      {head + "0 0" + bytes + " 1", "node 1 of the vocabulary has word -1"},
      {head + "0 1" + bytes + " 1\n1 1" + bytes + " 1", "node 2 of the vocabulary lies 2 below"},
      {good + "\n0 1" + bytes + " 1", "node 0 of the vocabulary has more than 2 children"},
  };
  for (auto const& f : faults) {
    auto const said = refusal(read_text, f.text);
    EXPECT_NE(said.find(f.message), std::string::npos) << f.message << "; said: " << said;
  }
}

struct comma : std::numpunct<char> {
  char do_decimal_point() const override { return ','; }
};

TEST(VocabularyText, ReadsNumbersWhateverTheLocale) {
  auto const v = test::drawn_vocabulary(2, 1);
  auto const want = ft::make_vocabulary(v.arrays());
  std::string const text = text_of(v);
  std::locale const before = std::locale::global({std::locale::classic(), new comma});
  auto const got = read_text(text);
  std::locale::global(before);
  expect_same(got.view(), want.view());
}

TEST(VocabularyFile, IsReadBack) {
  for (auto const& v : several()) {
    auto const made = ft::make_vocabulary(v.arrays());
    expect_same(load(file_of(made.view())).view(), made.view());
    auto const other = test::with_shuffled_ids(v, 5);
    auto const shuffled = ft::make_vocabulary(other.arrays());
    expect_same(load(file_of(shuffled.view())).view(), shuffled.view());
  }
}

TEST(VocabularyFile, IsReadFromTheMiddleOfAStreamAndFromAPipe) {
  auto const made = ft::make_vocabulary(test::drawn_vocabulary(3, 2).arrays());
  std::string const file = file_of(made.view());
  std::istringstream in("abc" + file);
  in.seekg(3);
  expect_same(ft::load_vocabulary(in).view(), made.view());
  one_way pipe(file);
  std::istream from(&pipe);
  expect_same(ft::load_vocabulary(from).view(), made.view());
}

TEST(VocabularyFile, IsRefusedWholeIfItIsCutOrDamaged) {
  auto const made = ft::make_vocabulary(test::drawn_vocabulary(3, 2).arrays());
  std::string const file = file_of(made.view());
  ASSERT_EQ(refusal(load, file), "");
  for (std::size_t size = 0; size < file.size(); ++size) {
    EXPECT_NE(refusal(load, file.substr(0, size)), "") << size;
  }
  EXPECT_NE(refusal(load, file + '\0').find("bytes after its end"), std::string::npos);
  for (std::size_t i = 0; i < file.size(); ++i) {
    for (int const bit : {0, 3, 7}) {
      std::string damaged = file;
      damaged[i] = static_cast<char>(damaged[i] ^ (1 << bit));
      EXPECT_NE(refusal(load, damaged), "") << "byte " << i << " bit " << bit;
    }
  }
  // The same bit of two words, which a plain product of odd numbers would not notice.
  std::string damaged = file;
  for (std::size_t const i : {file.size() - 9, file.size() - 9 - 32}) {
    damaged[i] = static_cast<char>(damaged[i] ^ 0x80);
  }
  EXPECT_NE(refusal(load, damaged).find("damaged"), std::string::npos);
}

TEST(VocabularyFile, SaysWhatIsWrong) {
  auto const made = ft::make_vocabulary(test::drawn_vocabulary(3, 2).arrays());
  std::string const file = file_of(made.view());
  auto const with = [&](std::size_t where, char value) {
    std::string changed = file;
    changed[where] = value;
    return refusal(load, changed);
  };
  EXPECT_NE(refusal(load, "").find("not a vocabulary file"), std::string::npos);
  EXPECT_NE(with(0, 'F').find("not a vocabulary file"), std::string::npos);
  EXPECT_NE(with(16, 2).find("another version"), std::string::npos);
  EXPECT_NE(with(20, 1).find("byte order"), std::string::npos);
  EXPECT_NE(with(40, 14).find("truncated"), std::string::npos);
  EXPECT_NE(with(43, -1).find("truncated"), std::string::npos) << "a negative number of nodes";
  EXPECT_NE(with(24, 21).find("branching"), std::string::npos);
  EXPECT_NE(with(file.size() - 20, 1).find("damaged"), std::string::npos);
  std::istringstream failed(file);
  failed.setstate(std::ios::failbit);
  EXPECT_THROW(ft::load_vocabulary(failed), ft::error);
  EXPECT_THROW(ft::read_vocabulary_text(failed), ft::error);
  std::ostringstream closed;
  closed.setstate(std::ios::badbit);
  EXPECT_THROW(ft::save_vocabulary(closed, made.view()), ft::error);
  EXPECT_THROW(ft::save_vocabulary(closed, ft::vocabulary_view{}), ft::bad_argument);
}

/// A stream that says whether more is asked for than it was given.
class counted : public std::streambuf {
public:
  explicit counted(std::string bytes, char then) : bytes_(std::move(bytes)), then_(then) {}
  std::size_t given = 0;

private:
  int_type underflow() override {  // one at a time, without end
    byte_ = given < bytes_.size() ? bytes_[given] : then_;
    ++given;
    setg(&byte_, &byte_, &byte_ + 1);
    return traits_type::to_int_type(byte_);
  }
  std::string bytes_;
  char then_;
  char byte_ = 0;
};

TEST(VocabularyFile, NoMoreIsReadThanItsHeadSays) {
  std::string const file =
      file_of(ft::make_vocabulary(test::drawn_vocabulary(3, 2).arrays()).view());
  counted twice(file, 'x');
  std::istream from(&twice);
  EXPECT_EQ(ft::load_vocabulary(from)->nodes, 13);
  EXPECT_EQ(twice.given, file.size());
  counted other(std::string(16, '?'), 'x');
  std::istream strange(&other);
  EXPECT_THROW(ft::load_vocabulary(strange), ft::error);
  EXPECT_EQ(other.given, 44u) << "its head";
  counted text("10 6 0 7\n", '1');
  std::istream of_text(&text);
  EXPECT_THROW(ft::read_vocabulary_text(of_text), ft::error);
  EXPECT_EQ(text.given, 9u) << "its first line";
  counted endless("", '1');
  std::istream of_ones(&endless);
  EXPECT_THROW(ft::read_vocabulary_text(of_ones), ft::error);
  EXPECT_LT(endless.given, 1000u);
}

TEST(VocabularyFile, MemoryGrowsWithWhatComesNotWithWhatTheHeadSays) {
  std::string file = file_of(ft::make_vocabulary(test::drawn_vocabulary(3, 2).arrays()).view());
  std::int32_t const most = 2147483647;
  std::memcpy(&file[40], &most, sizeof most);  // 105 GB
  EXPECT_NE(refusal(load, file).find("must be 105226698711"), std::string::npos);
  one_way pipe(file);
  std::istream from(&pipe);
  EXPECT_THROW(ft::load_vocabulary(from), ft::error);
}

/// A file whose checksum fits, of a vocabulary whose arrays are changed.
template <typename Change>
std::string said_of(Change const& change) {
  auto const made = ft::make_vocabulary(test::drawn_vocabulary(3, 2).arrays());
  change(made.view());
  return refusal(load, file_of(made.view()));
}

TEST(VocabularyFile, WhoseNumbersMakeNoTreeIsRefused) {
  using view = ft::vocabulary_view;
  EXPECT_EQ(said_of([](view const&) {}), "");
  std::string const tree = "ft: the nodes of the vocabulary file are not a tree";
  EXPECT_EQ(said_of([](view const& v) { v.children[0].count = 2; }), tree);
  EXPECT_EQ(said_of([](view const& v) { v.children[0].count = 0; }), tree);
  EXPECT_EQ(said_of([](view const& v) { v.children[0].count = 4; }), tree);
  EXPECT_EQ(said_of([](view const& v) { v.children[12].count = 1; }), tree);
  EXPECT_EQ(said_of([](view const& v) { std::swap(v.children[3].count, v.children[4].count); }),
            tree)
      << "deeper than its levels";
  std::string const range = "ft: the vocabulary file has numbers out of range";
  EXPECT_EQ(said_of([](view const& v) { v.node[0] = 1; }), range);
  EXPECT_EQ(said_of([](view const& v) { v.node[5] = 13; }), range);
  EXPECT_EQ(said_of([](view const& v) { v.node[5] = v.node[6]; }), range);
  EXPECT_EQ(said_of([](view const& v) { std::swap(v.node[5], v.node[6]); }), range);
  EXPECT_EQ(said_of([](view const& v) { v.word[5] = 9; }), range);
  EXPECT_EQ(said_of([](view const& v) { v.word[5] = v.word[6]; }), range);
  EXPECT_EQ(said_of([](view const& v) { v.word[5] = ft::no_word; }), range);
  EXPECT_EQ(said_of([](view const& v) { v.word[1] = 0; }), range);
  EXPECT_EQ(said_of([](view const& v) { v.weight[5] = HUGE_VAL; }), range);
}

}  // namespace vocabulary_files_test

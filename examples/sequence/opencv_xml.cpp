// SPDX-License-Identifier: Apache-2.0
#include <algorithm>
#include <cctype>
#include <utility>

#include "examples/sequence/detail/text.hpp"
#include "examples/sequence/detail/yaml_file.hpp"

namespace seq::detail {
namespace {

/// Elements and words; what OpenCV does not write (DTDs, mixed content) is refused.
class xml_reader {
public:
  xml_reader(std::string const& text, std::string const& path) : text_(text), path_(path) {}

  YAML::Node document() {
    skip();
    auto [name, node] = element(0);
    if (name != "opencv_storage") { fail("the root is <" + name + ">, must be <opencv_storage>"); }
    skip();
    if (at_ < text_.size()) { fail("text after </opencv_storage>"); }
    return node;
  }

private:
  static constexpr int deepest = 16;

  [[noreturn]] void fail(std::string const& reason) const {
    auto const end = text_.begin() + static_cast<std::ptrdiff_t>(std::min(at_, text_.size()));
    fail_at(path_, 1 + static_cast<int>(std::count(text_.begin(), end, '\n')),
            "not valid XML: " + reason);
  }
  bool starts(char const* part) const {
    return text_.compare(at_, std::char_traits<char>::length(part), part) == 0;
  }
  /// Goes behind the next `part`.
  void pass(char const* part) {
    std::size_t const found = text_.find(part, at_);
    if (found == std::string::npos) { fail(std::string("no ") + part); }
    at_ = found + std::char_traits<char>::length(part);
  }
  static bool blank(char c) { return std::isspace(static_cast<unsigned char>(c)) != 0; }
  /// Blanks, comments, the declaration.
  void skip() {
    for (;;) {
      while (at_ < text_.size() && blank(text_[at_])) { ++at_; }
      if (starts("<!--")) {
        pass("-->");
      } else if (starts("<?")) {
        pass("?>");
      } else {
        return;
      }
    }
  }

  std::pair<std::string, YAML::Node> element(int depth) {
    if (depth > deepest) {
      fail("more than " + std::to_string(deepest) + " elements in each other");
    }
    if (at_ >= text_.size() || text_[at_] != '<') { fail("no element"); }
    std::size_t const end = text_.find('>', at_);
    if (end == std::string::npos) { fail("no >"); }
    std::string const tag = text_.substr(at_ + 1, end - at_ - 1);
    std::string const name = tag.substr(0, tag.find_first_of(" \t\r\n/"));
    if (name.empty() || name[0] == '!') { fail("<" + name + ">"); }
    at_ = end + 1;
    YAML::Node node;
    if (!tag.empty() && tag.back() == '/') { return {name, node}; }
    skip();
    if (starts("</") || at_ >= text_.size() || text_[at_] != '<') {
      node = words(name);
    } else {
      while (!starts("</")) {
        auto [key, value] = element(depth + 1);
        if (key == "_") {
          if (node.IsMap()) { fail("<_> beside named elements"); }
          node.push_back(value);
        } else {
          if (node.IsSequence()) { fail("<" + key + "> beside <_>"); }
          if (node[key]) { fail("<" + key + "> is given twice"); }
          node[key] = value;
        }
        skip();
      }
    }
    if (!starts(("</" + name + ">").c_str())) { fail("no </" + name + ">"); }
    at_ += name.size() + 3;
    return {name, node};
  }

  /// A value, or a list of them: those of a matrix are always one.
  YAML::Node words(std::string const& name) {
    std::size_t const end = std::min(text_.find('<', at_), text_.size());
    std::string const text = trim(text_.substr(at_, end - at_));
    at_ = end;
    YAML::Node node;
    if (text.size() >= 2 && text.front() == '"' && text.back() == '"') {
      node = text.substr(1, text.size() - 2);
      return node;
    }
    std::vector<std::string> const parts = split(text, " \t\r\n", true);
    if (parts.size() == 1 && name != "data") {
      node = parts[0];
      return node;
    }
    for (std::string const& part : parts) { node.push_back(part); }
    return node;
  }

  std::string const& text_;
  std::string const& path_;
  std::size_t at_ = 0;
};

}  // namespace

YAML::Node read_opencv_xml(std::string const& text, std::string const& path) {
  return xml_reader(text, path).document();
}

}  // namespace seq::detail

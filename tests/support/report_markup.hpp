// SPDX-License-Identifier: Apache-2.0
/// @file Whether the markup of a report is sound.
#pragma once

#include <cctype>
#include <cstddef>
#include <set>
#include <sstream>
#include <string>
#include <vector>

namespace report_test {

inline std::vector<std::string> split(std::string const& text, char separator) {
  std::vector<std::string> out;
  std::string item;
  std::istringstream in(text);
  while (std::getline(in, item, separator)) { out.push_back(item); }
  if (!text.empty() && text.back() == separator && separator != '\n') { out.emplace_back(); }
  return out;
}

inline int count(std::string const& text, std::string const& word) {
  int n = 0;
  for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
    ++n;
  }
  return n;
}

/// Decimal digits with an optional sign and fraction, and nothing else.
inline bool is_number(std::string const& text) {
  auto const digits = [](std::string const& part) {
    return !part.empty() && part.find_first_not_of("0123456789") == std::string::npos;
  };
  std::string const magnitude = text.substr(text.rfind('-', 0) == 0 ? 1 : 0);
  std::size_t const point = magnitude.find('.');
  if (point == std::string::npos) { return digits(magnitude); }
  return digits(magnitude.substr(0, point)) && digits(magnitude.substr(point + 1));
}

/// True where `word` stands in `text` with no letter before or after it.
inline bool has_word(std::string const& text, std::string const& word) {
  auto const letter = [&](std::size_t i) {
    return i < text.size() && std::isalpha(static_cast<unsigned char>(text[i])) != 0;
  };
  for (std::size_t at = text.find(word); at != std::string::npos; at = text.find(word, at + 1)) {
    if ((at == 0 || !letter(at - 1)) && !letter(at + word.size())) { return true; }
  }
  return false;
}

/// The page's script; empty where there is none.
inline std::string script_of(std::string const& html) {
  std::size_t const begin = html.find("<script>");
  std::size_t const end = html.find("</script>");
  if (begin == std::string::npos || end == std::string::npos) { return {}; }
  return html.substr(begin + 8, end - begin - 8);
}

/// What a script has that it should not: a way to load something, to run a text as a script or to
/// end the element early; numbers that are none; brackets that do not match. Empty where all is
/// well.
inline std::string script_fault(std::string const& script) {
  for (char const* word :
       {"<",       "http", "fetch", "XMLHttp", "import",   "WebSocket", "Worker",         "Image",
        "url",     "src",  "href",  "eval",    "Function", "innerHTML", "document.write", "cookie",
        "Storage", "NaN",  "nan",   "Infinity"}) {
    if (script.find(word) != std::string::npos) { return word; }
  }
  if (has_word(script, "inf")) { return "inf"; }
  std::string open;
  char quote = 0;
  for (char const c : script) {
    if (quote != 0) {
      if (c == quote) { quote = 0; }
    } else if (c == '"' || c == '\'') {
      quote = c;
    } else if (c == '(' || c == '[' || c == '{') {
      open += c;
    } else if (c == ')' || c == ']' || c == '}') {
      char const wanted = c == ')' ? '(' : c == ']' ? '[' : '{';
      if (open.empty() || open.back() != wanted) { return std::string("stray ") + c; }
      open.pop_back();
    }
  }
  if (quote != 0) { return "text without end"; }
  return open;
}

/// What is wrong with the markup: tags that do not nest, attributes that do not parse, numbers that
/// are not numbers, references to elsewhere, more than the one script, one that could load
/// something. Empty where all is well. Pictures are cut out first.
inline std::string markup_fault(std::string html) {
  std::size_t const style = html.find("<style>");
  std::size_t const style_end = html.find("</style>");
  if (style == std::string::npos || style_end == std::string::npos) { return "no style"; }
  if (html.substr(style, style_end - style).find("url(") != std::string::npos) {
    return "url in style";
  }
  if (html.find("@import") != std::string::npos) { return "@import"; }
  html.erase(style + 7, style_end - style - 7);
  if (std::string const fault = script_fault(script_of(html)); !fault.empty()) {
    return "script: " + fault;
  }
  if (std::size_t const script = html.find("<script>"); script != std::string::npos) {
    std::size_t const end = html.find("</script>");
    if (end == std::string::npos || end < script) { return "script without end"; }
    html.erase(script, end + 9 - script);  // any other is a fault below
  }

  static std::set<std::string> const texts = {"class",   "role",    "aria-label",
                                              "lang",    "name",    "charset",
                                              "content", "href",    "preserveAspectRatio",
                                              "fill",    "stroke",  "stroke-linecap",
                                              "d",       "viewBox", "transform"};
  static std::set<std::string> const numbers = {
      "x", "y", "cx", "cy", "r", "rx", "width", "height", "stroke-width", "stroke-opacity"};
  auto const only = [](std::string const& value, char const* allowed) {
    return value.find_first_not_of(allowed) == std::string::npos;
  };
  std::vector<std::string> open;
  std::size_t at = 0;
  while ((at = html.find('<', at)) != std::string::npos) {
    std::size_t const end = html.find('>', at);
    if (end == std::string::npos) { return "unclosed <"; }
    std::string tag = html.substr(at + 1, end - at - 1);
    at = end + 1;
    if (tag.empty() || tag.find('<') != std::string::npos) {
      return "stray <: " + tag.substr(0, 80);
    }
    if (tag.front() == '!') { continue; }
    if (tag.front() == '/') {
      if (open.empty() || open.back() != tag.substr(1)) { return "closes nothing: " + tag; }
      open.pop_back();
      continue;
    }
    bool const closed = tag.back() == '/';
    if (closed) { tag.pop_back(); }
    std::size_t p = tag.find_first_of(" \n");
    std::string const name = tag.substr(0, p);
    if (name == "script" || name == "link" || name == "iframe" || name == "img") { return name; }
    while (p != std::string::npos && (p = tag.find_first_not_of(" \n", p)) != std::string::npos) {
      std::size_t const equals = tag.find("=\"", p);
      if (equals == std::string::npos) { return "attribute without value: " + tag.substr(p, 80); }
      std::size_t const quote = tag.find('"', equals + 2);
      if (quote == std::string::npos) { return "attribute without quote: " + tag.substr(p, 80); }
      std::string const key = tag.substr(p, equals - p);
      std::string const value = tag.substr(equals + 2, quote - equals - 2);
      p = quote + 1;
      std::string const where = name + ' ' + key + "=" + value.substr(0, 80);
      if (numbers.count(key) != 0) {
        if (name == "meta" || !is_number(value)) { return "not a number: " + where; }
      } else if (texts.count(key) == 0) {
        return "unknown attribute: " + where;
      }
      if (key == "d" && (value.empty() || !only(value, "MLHVZzlhv0123456789.- "))) {
        return "path: " + where;
      }
      if (key == "viewBox" && !only(value, "0123456789. ")) { return "view box: " + where; }
      if (key == "transform" && !only(value, "translateo()0123456789.- ")) {
        return "transform: " + where;
      }
      if (key == "href" && value.rfind("data:image/jpeg;base64,", 0) != 0) {
        return "reference: " + where;
      }
      if (key == "src") { return "reference: " + where; }
    }
    if (!closed && name != "meta") { open.push_back(name); }
  }
  return open.empty() ? std::string() : "never closed: " + open.back();
}

}  // namespace report_test

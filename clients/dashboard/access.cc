#include "clients/dashboard/access.h"

#include <fmt/format.h>

#include <algorithm>
#include <boost/asio/ip/address.hpp>
#include <cctype>
#include <stdexcept>

namespace secondskin::dashboard {
namespace {

bool same_nocase(std::string_view a, std::string_view b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(), [](unsigned char x, unsigned char y) {
    return std::tolower(x) == std::tolower(y);
  });
}

// Takes as long whatever differs, so that a token cannot be found out letter by letter.
bool same_secret(std::string_view given, std::string_view secret) {
  unsigned char difference = given.size() == secret.size() ? 0 : 1;
  for (std::size_t i = 0; i < given.size(); ++i) {
    difference |= static_cast<unsigned char>(given[i] ^ secret[i % secret.size()]);
  }
  return difference == 0;
}

std::string_view bearer(std::string_view authorization) {
  constexpr std::string_view kScheme = "Bearer ";
  if (!same_nocase(authorization.substr(0, kScheme.size()), kScheme)) return {};
  return authorization.substr(kScheme.size());
}

std::string_view cookie_value(std::string_view cookies, std::string_view name) {
  while (!cookies.empty()) {
    const auto end = cookies.find(';');
    std::string_view one = cookies.substr(0, end);
    cookies = end == std::string_view::npos ? std::string_view() : cookies.substr(end + 1);
    one.remove_prefix(std::min(one.find_first_not_of(' '), one.size()));
    if (one.starts_with(name) && one.substr(name.size()).starts_with('=')) {
      return one.substr(name.size() + 1);
    }
  }
  return {};
}

// "127.0.0.1:8765" -> "127.0.0.1", "[::1]:8765" -> "[::1]"
std::string_view without_port(std::string_view host) {
  const auto colon = host.rfind(':');
  const auto bracket = host.rfind(']');
  if (colon == std::string_view::npos) return host;
  if (bracket != std::string_view::npos && colon < bracket) return host;
  return host.substr(0, colon);
}

bool names_this_machine(std::string_view host) {
  std::string_view name = without_port(host);
  if (same_nocase(name, "localhost")) return true;
  if (name.starts_with('[') && name.ends_with(']')) name = name.substr(1, name.size() - 2);
  // As an address: "127.example.org" is a name that anybody may give to this machine's.
  boost::system::error_code error;
  const auto address = boost::asio::ip::make_address(std::string(name), error);
  return !error && address.is_loopback();
}

std::string_view without_scheme(std::string_view origin) {
  const auto at = origin.find("://");
  return at == std::string_view::npos ? std::string_view() : origin.substr(at + 3);
}

}  // namespace

Access judge(const AccessRules& rules, const Credentials& c) {
  const bool allowed_origin =
      std::any_of(rules.allowed_origins.begin(), rules.allowed_origins.end(),
                  [&](const std::string& allowed) { return same_nocase(allowed, c.origin); });
  if (c.changes && !c.origin.empty() && !allowed_origin &&
      !same_nocase(without_scheme(c.origin), c.host)) {
    return Access::kForeignOrigin;
  }
  if (!rules.token.empty()) {
    for (const auto& given :
         {bearer(c.authorization), c.query_token, cookie_value(c.cookie, kTokenCookie)}) {
      if (!given.empty() && same_secret(given, rules.token)) return Access::kGranted;
    }
    return Access::kNoToken;
  }
  // Programs may leave the header out; browsers cannot.
  const bool allowed_host = std::any_of(
      rules.allowed_origins.begin(), rules.allowed_origins.end(),
      [&](const std::string& allowed) { return same_nocase(without_scheme(allowed), c.host); });
  if (!c.host.empty() && !names_this_machine(c.host) && !allowed_host) return Access::kForeignHost;
  return Access::kGranted;
}

bool is_loopback(const std::string& address) {
  boost::system::error_code error;
  const auto ip = boost::asio::ip::make_address(address, error);
  if (error) {
    throw std::runtime_error(
        fmt::format("bind '{}': expected an IP address, e.g. 127.0.0.1 or 0.0.0.0", address));
  }
  return ip.is_loopback();
}

}  // namespace secondskin::dashboard

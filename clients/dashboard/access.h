#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

/// Who may use the dashboard's port. Pure.
///
/// Two dangers are met: a stranger on the network (a token), and a foreign web page in a browser of
/// this machine, which can send requests to 127.0.0.1 (the Origin header) or give its own name that
/// address (the Host header, where no token guards).
namespace secondskin::dashboard {

/// The cookie in which a page that was opened with ?token= keeps it.
inline constexpr std::string_view kTokenCookie = "secondskin_token";

struct AccessRules {
  std::string token;                         ///< empty: none is asked
  std::vector<std::string> allowed_origins;  ///< beside the own host, e.g. "https://app.example"
};

/// What a request says of itself; empty where it says nothing.
struct Credentials {
  bool changes = false;  ///< a WebSocket, or a method other than GET and HEAD
  std::string_view host{}, origin{}, authorization{}, cookie{}, query_token{};
};

enum class Access : std::uint8_t { kGranted, kNoToken, kForeignHost, kForeignOrigin };

Access judge(const AccessRules& rules, const Credentials& credentials);

/// Whether an address is of this machine alone. @throws std::runtime_error when it is no IP
/// address.
bool is_loopback(const std::string& address);

}  // namespace secondskin::dashboard

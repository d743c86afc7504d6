// Copyright The fuzzycnc authors
// SPDX-License-Identifier: Apache-2.0
// Light, dark, or as the system says. No module: it runs before the first paint.
(() => {
  const KEY = 'fuzzycnc.theme';
  const NEXT = {system: 'light', light: 'dark', dark: 'system'};
  let theme = localStorage.getItem(KEY) in NEXT ? localStorage.getItem(KEY) : 'system';

  function apply() {
    document.documentElement.dataset.theme = theme;
    const button = document.getElementById('theme');
    if (button) {
      const [sign, word] = button.children;
      sign.textContent = {system: '◐', light: '○', dark: '●'}[theme];
      word.textContent = theme;
      button.setAttribute('aria-label', `Theme: ${theme}. Change to ${NEXT[theme]}.`);
    }
    // Canvases do not follow style sheets by themselves.
    document.dispatchEvent(new Event('theme'));
  }

  apply();
  matchMedia('(prefers-color-scheme: dark)').addEventListener('change', apply);
  document.addEventListener('DOMContentLoaded', () => {
    apply();
    document.getElementById('theme').addEventListener('click', () => {
      theme = NEXT[theme];
      localStorage.setItem(KEY, theme);
      apply();
    });
  });
})();

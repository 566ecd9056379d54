// The token and the settings.
import { keepToken, save, token, type Settings } from "./settings.ts";
import { element, say } from "./surface.ts";

/** Asks for a token; `connect` runs once there is one. */
export class TokenDialogue {
  private readonly dialog = element<HTMLDialogElement>("token-dialog");
  private readonly input = element<HTMLInputElement>("token");

  constructor(connect: () => void) {
    element("token-cancel").addEventListener("click", () => this.dialog.close());
    closes(this.dialog);
    element("token-form").addEventListener("submit", () => {
      const value = this.input.value.trim();
      this.input.value = "";
      if (!value) return;
      keepToken(value);
      connect();
    });
  }

  ask(wrong: boolean): void {
    if (wrong) keepToken(null);
    say(element("token-wrong"), wrong ? "The program does not know this token. Look for a missing or extra character." : "");
    open(this.dialog);
    this.input.focus();
  }

  close(): void {
    if (this.dialog.open) this.dialog.close();
  }
}

/** Binds the settings' form; `changed` runs after each change. */
export function bindSettings(settings: Settings, changed: (name: keyof Settings) => void, otherToken: () => void): void {
  const dialog = element<HTMLDialogElement>("settings");
  const form = element<HTMLFormElement>("settings-form");
  for (const field of form.querySelectorAll<HTMLInputElement | HTMLSelectElement>("[name]")) {
    const name = field.name as keyof Settings;
    const value = settings[name];
    if (field instanceof HTMLInputElement && field.type === "checkbox") field.checked = Boolean(value);
    else field.value = value === null ? "" : String(value);
    field.addEventListener("change", () => {
      const to: Record<string, unknown> = settings as unknown as Record<string, unknown>;
      if (field instanceof HTMLInputElement && field.type === "checkbox") to[name] = field.checked;
      else if (name === "bandwidth_kbps" || name === "density") to[name] = field.value === "" ? null : Number(field.value);
      else to[name] = typeof value === "number" ? Number(field.value) : field.value;
      save(settings);
      changed(name);
    });
  }
  element("open-settings").addEventListener("click", () => (dialog.open ? dialog.close() : open(dialog)));
  closes(dialog);
  element("other-token").addEventListener("click", () => {
    dialog.close();
    otherToken();
  });
  if (token() === null && location.hostname.match(/^(127\.|localhost$|\[::1\]$)/)) element("other-token").hidden = true;
}

// Never modal: Stop and Laser off stay one click away.
function open(dialog: HTMLDialogElement): void {
  if (!dialog.open) dialog.show();
}

function closes(dialog: HTMLDialogElement): void {
  let before: Element | null = null;
  dialog.addEventListener("focusin", (event) => {
    if (event.relatedTarget instanceof HTMLElement && !dialog.contains(event.relatedTarget)) before = event.relatedTarget;
  });
  dialog.addEventListener("keydown", (event) => {
    if (event.key === "Escape") dialog.close();
  });
  dialog.addEventListener("close", () => {
    if (before instanceof HTMLElement) before.focus();
  });
}
